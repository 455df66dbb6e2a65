# pyright: strict
"""Whole campaigns on the virtual rig by the hundred: are stated uncertainties right, do points pass that should?

A tile is a campaign with a seed of its own: every guided test is run on simulated time through drivers, wire bytes and
logs, parameters are identified from the logs, and the points are judged with them. Nothing but the logs' bytes tells
identification about the rig.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from daq.errors import RigError
from daq.guided_tests.test_inputs import possible_tests
from daq.lockstep.rehearsal import Rehearsal
from identification import IdentificationError, identify
from rig_configs import RigFileError, load_rig
from studies.runs import load_runs, validated
from studies.study import Answer, Study
from studies.tile_files import TileFolder

_BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
_USUAL = 1.959963984540054  # of a standard normal variable, 95 % lie within


def campaign_study(rig_text: str, settings: Sequence[str], first_seed: int, campaigns: int) -> Study:
    """The study of so many campaigns.

    Args:
        rig_text: a rig file's text, with a [virtual] table.
        settings: "key=value" laid over it.
        first_seed: of the first campaign; the others' count up from it.
        campaigns: how many.
    """
    asked = {"rig": rig_text, "settings": list(settings), "first_seed": first_seed, "campaigns": campaigns}
    return Study.of("campaigns", asked)


@lru_cache(maxsize=4)
def _asked(text: str) -> Mapping[str, Any]:
    return json.loads(text)


class Campaigns:
    """See Kind: parameters with truth and standard deviations, points with verdicts and z-scores, warnings.

    A campaign that cannot be ended (a test refused, nothing to be identified) has an `error` in words instead.
    """

    uses_threads = False

    def tiles(self, text: str) -> int:
        """See Kind."""
        return int(_asked(text)["campaigns"])

    def part(self, text: str, tile: int) -> str:
        """See Kind: a seed's campaign is the same among any number of others."""
        asked = _asked(text)
        own = {name: asked[name] for name in ("rig", "settings")}
        return Study.question(own | {"seed": int(asked["first_seed"]) + tile})

    def warm_up(self, text: str) -> None:
        """See Kind: importing is all that can be done beforehand; the first campaign compiles the rest."""

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """See Kind."""
        asked = _asked(text)
        seed = int(asked["first_seed"]) + tile
        with tempfile.TemporaryDirectory(prefix="rig-campaign-") as name:
            folder = Path(name)
            rig = folder / "rig.toml"
            rig.write_text(asked["rig"], encoding="utf-8")
            try:
                return {"seed": np.array(seed), **_campaign(rig, [*asked["settings"], f"virtual.seed={seed}"])}
            except (RigError, IdentificationError, AnalysisError) as fault:
                return {"seed": np.array(seed), "error": np.array(f"{type(fault).__name__}: {fault}")}


def _campaign(rig_file: Path, settings: list[str]) -> Answer:
    """One campaign, its logs in the rig file's folder."""
    with Rehearsal(rig_file, rig_file.parent / "logs", settings) as rehearsal:
        rig, truth = rehearsal.rig, dict(rehearsal.truth)
        tests = possible_tests(rig)
        before = load_runs([rehearsal.record(test).log for test in _BEFORE_POINTS if test in tests])
        found = identify(before, rig)
        known = found.parameters
        logs = [rehearsal.record(test, known).log for test in tests if test.startswith("point-")]
    judged = validated(load_runs(logs), rig, known, _told_nobody)
    names, std = list(known.values), known.std
    z = {(point, name): z for point, one in judged.points.items() for name, z in one.z_scores.items()}
    return {
        "names": np.array(names),
        "values": np.array([known.values[name] for name in names]),
        "std": np.array([std[name] for name in names]),
        "covariance": known.covariance,
        "truth": np.array([truth.get(name, np.nan) for name in names]),
        "points": np.array(list(judged.points), dtype=str),
        "states": np.array([one.state for one in judged.points.values()], dtype=str),
        "verdicts": np.array([one.verdict for one in judged.points.values()], dtype=str),
        "quantities": np.array([f"{point} {name}" for point, name in z], dtype=str),
        "z": np.array(list(z.values()), dtype=float),
        "passed": np.array(judged.passed),
        "warnings": np.array([*found.warnings, *judged.warnings], dtype=str),
    }


def _told_nobody(text: str) -> None:
    del text


@dataclass(frozen=True)
class CampaignResults:
    """What a study of campaigns found.

    Attributes:
        rows: of every campaign, in the order of the seeds.
    """

    rows: Sequence[Mapping[str, NDArray[Any]]]

    @classmethod
    def of(cls, folder: TileFolder) -> CampaignResults:
        """From the finished tiles of a folder.

        Raises:
            FolderFault: one is damaged.
        """
        return cls([folder.read(tile) for tile in sorted(folder.finished())])

    @cached_property
    def done(self) -> list[Mapping[str, NDArray[Any]]]:
        """Campaigns that came to their end."""
        return [row for row in self.rows if "error" not in row]

    @property
    def failed(self) -> dict[int, str]:
        """Seed to the reason of campaigns that did not."""
        return {int(row["seed"]): str(row["error"]) for row in self.rows if "error" in row}

    @property
    def passed(self) -> int:
        """Campaigns all of whose points pass."""
        return sum(bool(row["passed"]) for row in self.done)

    def parameter_z(self) -> dict[str, NDArray[np.floating]]:
        """Parameter to (found − true)/std of every campaign that found it."""
        found: dict[str, list[float]] = {}
        for row in self.done:
            for name, value, std, truth in zip(row["names"], row["values"], row["std"], row["truth"], strict=True):
                if np.isfinite(truth) and std > 0:
                    found.setdefault(str(name), []).append(float((value - truth) / std))
        return {name: np.array(values) for name, values in found.items()}

    def point_z(self) -> dict[str, NDArray[np.floating]]:
        """ "POINT quantity" to z of every campaign."""
        found: dict[str, list[float]] = {}
        for row in self.done:
            for name, z in zip(row["quantities"], row["z"], strict=True):
                found.setdefault(str(name), []).append(float(z))
        return {name: np.array(values) for name, values in found.items()}

    def verdicts(self) -> dict[str, dict[str, int]]:
        """Point to verdict to how many campaigns gave it."""
        found: dict[str, dict[str, int]] = {}
        for row in self.done:
            for point, verdict in zip(row["points"], row["verdicts"], strict=True):
                counts = found.setdefault(str(point), {})
                counts[str(verdict)] = counts.get(str(verdict), 0) + 1
        return found


def within(z: NDArray[np.floating]) -> int:
    """How many of the z lie within the 95 % of a standard normal variable."""
    return int(np.sum(np.abs(z) < _USUAL))


def need_virtual(rig_file: Path | str, settings: Sequence[str]) -> None:
    """Whether campaigns can be run on a rig.

    Raises:
        RigFileError: it is no virtual one, or has no test to run.
    """
    rig = load_rig(rig_file, settings=list(settings))
    if rig.virtual is None:
        raise RigFileError(f"{rig_file}: expected a rig file with a [virtual] table, as the shipped `virtual` has")
    if not possible_tests(rig):
        raise RigFileError(f"{rig_file}: its devices have the signals for no guided test")


KIND = Campaigns()
