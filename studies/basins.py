"""Basins in tiles: each tile is a part of the grid of releases."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from analysis.maps.question import SourceText
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.basins.basin_map import BasinMap, basins, same_orbit
from dynamics.steady.basins.ends import End
from dynamics.steady.basins.following import STATED_ERROR_RAD
from dynamics.steady.basins.slipping_orbits import SlippingOrbit
from rig_basics.arrays import Array
from rig_configs import IdentifiedParameters
from rig_configs.load import rig_from_text
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder
from studies.tiling import Part, parts_of

_MAX_RELEASES, _MAX_COLUMNS = 2400, 60  # of one tile; columns along θ3
_SAME_RAD = 1e-3  # largest difference between the angles of one steady state
_GRIDS = ("end", "sure", "caught_s", "settled_s", "amplitude_m", "apart_rad", "turns")


@dataclass(frozen=True)
class BasinQuestion:
    """Inputs that determine a basin map.

    Attributes:
        rig: rig file.
        parameters: identified parameters applied to it, or None; a bow is included.
        settings: "key=value" settings, applied last.
        speed_rad_s: speed of the rotor.
        releases: number of releases along θ3 and θ4, over the whole circle.
        seconds: duration of each release, s.
    """

    rig: SourceText
    parameters: SourceText | None
    settings: tuple[str, ...]
    speed_rad_s: float
    releases: tuple[int, int]
    seconds: float

    @property
    def known(self) -> IdentifiedParameters:
        """Identified parameters; empty if none were given."""
        if self.parameters is None:
            return IdentifiedParameters({}, np.zeros((0, 0)))
        return IdentifiedParameters.from_text(self.parameters.text, self.parameters.source)

    @property
    def physics(self) -> RotorParameters:
        """Parameters of the released rig."""
        known = self.known
        rig = rig_from_text(self.rig.source, self.rig.text, known, self.settings)
        return known.with_effects(rig.physics)

    @property
    def angles_rad(self) -> tuple[Array, Array]:
        """Middles of equal parts of the circle, θ3 from −180°, θ4 from 0°."""
        across, up = self.releases
        three = -180.0 + (np.arange(across) + 0.5) * 360.0 / across
        return np.radians(three), np.radians((np.arange(up) + 0.5) * 360.0 / up)

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers and texts for `of_json`."""
        return {
            "rig": self.rig.as_json(),
            "parameters": None if self.parameters is None else self.parameters.as_json(),
            "settings": list(self.settings),
            "speed_rad_per_s": self.speed_rad_s,
            "releases": list(self.releases),
            "seconds": self.seconds,
        }

    @classmethod
    def of_json(cls, table: dict[str, Any]) -> BasinQuestion:
        """Return the question of an `as_json` table."""
        known = table["parameters"]
        across, up = table["releases"]
        return cls(
            SourceText.of_json(table["rig"]),
            None if known is None else SourceText.of_json(known),
            tuple(table["settings"]),
            float(table["speed_rad_per_s"]),
            (int(across), int(up)),
            float(table["seconds"]),
        )


def basin_study(question: BasinQuestion) -> Study:
    """Return the study of a basin map."""
    return Study.of("basins", question.as_json())


@lru_cache(maxsize=8)
def _parsed(text: str) -> tuple[BasinQuestion, RotorParameters, list[Part]]:
    question = BasinQuestion.of_json(json.loads(text))
    across, up = question.releases
    return question, question.physics, parts_of(across, up, _MAX_COLUMNS, _MAX_RELEASES)


class Basins(Kind):
    """Kind of study: a part of a basin map, and the end states of its releases."""

    uses_threads = True

    @override
    def tiles(self, text: str) -> int:
        return len(_parsed(text)[2])

    @override
    def part(self, text: str, tile: int) -> None:
        """Return None: the tile's number is sufficient."""

    @override
    def warm_up(self, text: str) -> None:
        question, physics, _ = _parsed(text)
        three, four = question.angles_rad
        basins(physics, question.speed_rad_s, three[:1], four[:1], 2 * math.pi / question.speed_rad_s, workers=1)

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Compute one part of the grid."""
        question, physics, parts = _parsed(text)
        rows, columns = parts[tile]
        three, four = question.angles_rad
        found = basins(physics, question.speed_rad_s, three[columns], four[rows], question.seconds, workers=threads)
        return {name: np.asarray(getattr(found, name)) for name in _GRIDS} | _packed(found.ends)


def assembled(folder: TileFolder) -> BasinMap:
    """Assemble the basin map of a folder with all tiles.

    A slipping orbit is known only in the tiles whose releases led to it. Releases of other tiles that would reach it
    are "not settled".

    Raises:
        FolderFault: a tile is damaged or missing.
    """
    question, _, parts = _parsed(folder.study.text)
    three, four = question.angles_rad
    grids: dict[str, NDArray[Any]] = {}
    ends: list[End] = []
    for tile, part in enumerate(parts):
        answer = folder.read(tile)
        numbers = [_number_of(end, ends) for end in _unpacked(answer)]
        answer["end"] = np.array([*numbers, -1], np.int64)[answer["end"]]  # index −1 is the last element
        for name in _GRIDS:
            values = answer[name]
            grid = grids.setdefault(name, np.empty((len(four), len(three), *values.shape[2:]), values.dtype))
            grid[part] = values
    return BasinMap(
        three,
        four,
        tuple(ends),
        grids["end"],
        grids["sure"],
        grids["caught_s"],
        grids["settled_s"],
        grids["amplitude_m"],
        grids["apart_rad"],
        grids["turns"],
        question.seconds,
        STATED_ERROR_RAD,
        question.speed_rad_s,
    )


def _packed(ends: Sequence[End]) -> Answer:
    none = (math.nan, math.nan)
    orbits = [end.slipping for end in ends]
    return {
        "end_name": np.array([end.name for end in ends], dtype=str),
        "end_mirror": np.array([end.mirror for end in ends], np.int64),
        "end_theta_rad": np.array([end.theta_rad or none for end in ends], np.float64).reshape(-1, 2),
        "end_amplitude_m": np.array([end.amplitude_m for end in ends], np.float64),
        "end_multiplier": np.array([end.multiplier for end in ends], np.float64),
        "end_start": np.array([end.start for end in ends], np.float64).reshape(-1, 8),
        "end_turns": np.array([o.turns_per_revolution if o else none for o in orbits], np.float64).reshape(-1, 2),
        "end_winding": np.array([o.winding if o else (0, 0) for o in orbits], np.int64).reshape(-1, 2),
        "end_period": np.array([o.period_revolutions if o else 0 for o in orbits], np.int64),
        "end_rotation": np.array([o.rotation if o else math.nan for o in orbits], np.float64),
        "end_residual": np.array([o.residual if o else math.nan for o in orbits], np.float64),
        "end_multipliers": np.array([o.multipliers if o else np.full(8, math.nan) for o in orbits]).reshape(-1, 8),
    }


def _unpacked(answer: Answer) -> list[End]:
    found: list[End] = []
    for i, name in enumerate(answer["end_name"].tolist()):
        amplitude, multiplier = float(answer["end_amplitude_m"][i]), float(answer["end_multiplier"][i])
        start, mirror = answer["end_start"][i], int(answer["end_mirror"][i])
        if name != "slipping":
            a, b = answer["end_theta_rad"][i].tolist()
            found.append(End(name, mirror, (a, b), amplitude, multiplier, start, None))
            continue
        turns, winding = answer["end_turns"][i].tolist(), answer["end_winding"][i].tolist()
        orbit = SlippingOrbit(
            (turns[0], turns[1]),
            (winding[0], winding[1]),
            int(answer["end_period"][i]),
            float(answer["end_rotation"][i]),
            float(answer["end_residual"][i]),
            answer["end_multipliers"][i],
            multiplier,
            amplitude,
            start[None, :],
            np.zeros((0, 8, 8)),
            0,
            1,
            math.nan,
            np.zeros((0, 8)),
        )
        found.append(End(name, mirror, None, amplitude, multiplier, start, None, orbit))
    return found


def _number_of(end: End, ends: list[End]) -> int:
    """Return the index of an end state, which is appended if it is new."""
    for i, other in enumerate(ends):
        if end.slipping is not None and other.slipping is not None:
            same = same_orbit(end.slipping, other.slipping)
        elif end.theta_rad is not None and other.theta_rad is not None:
            away = np.exp(1j * np.array(end.theta_rad)) - np.exp(1j * np.array(other.theta_rad))
            same = end.name == other.name and float(np.max(np.abs(away))) < _SAME_RAD
        else:
            same = False
        if same:
            return i
    alike = sum(other.name == end.name for other in ends)
    ends.append(replace(end, mirror=alike) if end.slipping is not None else end)
    return len(ends) - 1


KIND = Basins()
