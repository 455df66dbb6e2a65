"""Hundreds of campaigns on the virtual rig: coverage of the stated uncertainties, and pass rate of valid points.

A tile is a campaign with a seed of its own. Every guided test runs on simulated time through drivers, wire bytes and
logs. Parameters are identified from the logs, and the points are validated with them. The identification has no access
to the simulated rig except through the bytes of the logs.
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
from typing_extensions import override

from analysis.errors import AnalysisError
from daq.errors import AcquisitionError
from daq.guided_test_kinds import point_of
from daq.guided_tests.test_inputs import possible_tests
from daq.lockstep.rehearsal import Rehearsal
from identification import IdentificationError, identify
from rig_configs import RigFileError, load_rig
from studies.runs import load_runs
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder
from studies.validated_runs import validated

_BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
_NORMAL_95 = 1.959963984540054  # half width of the 95 % interval of a standard normal variable


def campaign_study(rig_text: str, settings: Sequence[str], first_seed: int, campaigns: int) -> Study:
    """Return the study of several campaigns.

    Args:
        rig_text: text of a rig file with a [virtual] table.
        settings: "key=value" settings applied to it.
        first_seed: seed of the first campaign; the others follow.
        campaigns: number of campaigns.
    """
    question = {"rig": rig_text, "settings": list(settings), "first_seed": first_seed, "campaigns": campaigns}
    return Study.of("campaigns", question)


@lru_cache(maxsize=4)
def _question(text: str) -> Mapping[str, Any]:
    return json.loads(text)


class Campaigns(Kind):
    """Kind of study: parameters with truth and standard deviations, points with verdicts and z-scores, warnings.

    A campaign that fails (a refused test, nothing to identify) has an `error` in words instead.
    """

    uses_threads = False

    @override
    def tiles(self, text: str) -> int:
        return int(_question(text)["campaigns"])

    @override
    def part(self, text: str, tile: int) -> str:
        """Return the part of one seed, whose campaign does not depend on the number of campaigns."""
        question = _question(text)
        own = {name: question[name] for name in ("rig", "settings")}
        return Study.question(own | {"seed": int(question["first_seed"]) + tile})

    @override
    def warm_up(self, text: str) -> None:
        """Do nothing: the import is sufficient, and the first campaign compiles the remaining code."""

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Run one campaign."""
        question = _question(text)
        seed = int(question["first_seed"]) + tile
        with tempfile.TemporaryDirectory(prefix="rig-campaign-") as name:
            folder = Path(name)
            rig = folder / "rig.toml"
            rig.write_text(question["rig"], encoding="utf-8")
            try:
                return {"seed": np.array(seed), **_campaign(rig, [*question["settings"], f"virtual.seed={seed}"])}
            except (AcquisitionError, IdentificationError, AnalysisError) as fault:
                return {"seed": np.array(seed), "error": np.array(f"{type(fault).__name__}: {fault}")}


def _campaign(rig_file: Path, settings: list[str]) -> Answer:
    """Run one campaign with its logs in the rig file's folder."""
    with Rehearsal(rig_file, rig_file.parent / "logs", settings) as rehearsal:
        rig, truth = rehearsal.rig, dict(rehearsal.truth)
        tests = possible_tests(rig)
        before = load_runs([rehearsal.record(test).log for test in _BEFORE_POINTS if test in tests])
        found = identify(before, rig)
        known = found.parameters
        logs = [rehearsal.record(test, known).log for test in tests if point_of(test)]
    judged = validated(load_runs(logs), rig, known, _ignore)
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


def _ignore(text: str) -> None:
    del text


@dataclass(frozen=True)
class CampaignResults:
    """Results of a study of campaigns.

    Attributes:
        rows: arrays of every campaign, in the order of the seeds.
    """

    rows: Sequence[Mapping[str, NDArray[Any]]]

    @classmethod
    def of(cls, folder: TileFolder) -> CampaignResults:
        """Read the finished tiles of a folder.

        Raises:
            FolderFault: a tile is damaged.
        """
        return cls([folder.read(tile) for tile in sorted(folder.finished())])

    @cached_property
    def done(self) -> list[Mapping[str, NDArray[Any]]]:
        """Campaigns that were completed."""
        return [row for row in self.rows if "error" not in row]

    @property
    def failed(self) -> dict[int, str]:
        """Seed → reason of campaigns that failed."""
        return {int(row["seed"]): str(row["error"]) for row in self.rows if "error" in row}

    @property
    def passed(self) -> int:
        """Number of campaigns whose points all pass."""
        return sum(bool(row["passed"]) for row in self.done)

    def parameter_z(self) -> dict[str, NDArray[np.floating]]:
        """Return parameter → (found − true)/std of every campaign that identified it."""
        found: dict[str, list[float]] = {}
        for row in self.done:
            for name, value, std, truth in zip(row["names"], row["values"], row["std"], row["truth"], strict=True):
                if np.isfinite(truth) and std > 0:
                    found.setdefault(str(name), []).append(float((value - truth) / std))
        return {name: np.array(values) for name, values in found.items()}

    def point_z(self) -> dict[str, NDArray[np.floating]]:
        """Return "POINT quantity" → z of every campaign."""
        found: dict[str, list[float]] = {}
        for row in self.done:
            for name, z in zip(row["quantities"], row["z"], strict=True):
                found.setdefault(str(name), []).append(float(z))
        return {name: np.array(values) for name, values in found.items()}

    def verdicts(self) -> dict[str, dict[str, int]]:
        """Return point → verdict → number of campaigns with it."""
        found: dict[str, dict[str, int]] = {}
        for row in self.done:
            for point, verdict in zip(row["points"], row["verdicts"], strict=True):
                counts = found.setdefault(str(point), {})
                counts[str(verdict)] = counts.get(str(verdict), 0) + 1
        return found


def within(z: NDArray[np.floating]) -> int:
    """Return the number of z within the 95 % interval of a standard normal variable."""
    return int(np.sum(np.abs(z) < _NORMAL_95))


def need_virtual(rig_file: Path | str, settings: Sequence[str]) -> None:
    """Check that campaigns can be run on a rig.

    Raises:
        RigFileError: the rig is not virtual, or has no guided test.
    """
    rig = load_rig(rig_file, settings=list(settings))
    if rig.virtual is None:
        raise RigFileError(f"{rig_file}: expected a rig file with a [virtual] table, as the shipped `virtual` has")
    if not possible_tests(rig):
        raise RigFileError(f"{rig_file}: its devices have the signals for no guided test")


KIND = Campaigns()
