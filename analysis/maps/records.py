"""Contents of a map's file: arrays over x and y, borders as lines, and their provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.maps.answers import MapAnswer
from analysis.maps.coexistence import CoexistenceMap
from analysis.maps.question import MapQuestion
from analysis.maps.states import StateMap
from daq.version import software_version
from dynamics.stability.borders import Borders

FORMAT = "rig map 1"
"""Kind and version of the files; a later layout has a higher version."""


@dataclass(frozen=True)
class RecordedBorder:
    """One branch of a border.

    Attributes:
        x, y: coordinates of its points in order, shape (n,); the stable side is on the left.
        multiplier: multiplier on the unit circle, complex, shape (n,).
        closed: whether the branch is a closed curve.
        value: value of a family's number; None for the rig itself.
    """

    x: NDArray[np.floating]
    y: NDArray[np.floating]
    multiplier: NDArray[np.complexfloating]
    closed: bool
    value: float | None = None


@dataclass(frozen=True)
class MapRecord:
    """Contents of a map's file.

    Attributes:
        provenance: JSON: format, software and version, date, rig and parameters with their digests, settings, method,
            accuracy, `question` (inputs of `rig map`, rig file included) and the numerical results.
        x, y: values of the axes, shapes (n,) and (m,).
        grid: arrays over them, shape (m, n): multiplier_max, error_estimate, decay_rate_per_s, and of a refined map
            `computed`, False where a value is interpolated.
        borders: borders of the rig itself first, then of each value of a family.
    """

    provenance: Mapping[str, Any]
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    grid: Mapping[str, NDArray[Any]]
    borders: tuple[RecordedBorder, ...] = field(default=())

    @property
    def question(self) -> MapQuestion:
        """Question of the map; `analysis.maps.answers.answer` computes the map again from it."""
        return MapQuestion.of_json(self.provenance["question"])


def record(found: MapAnswer, numbers: Mapping[str, Any]) -> MapRecord:
    """Return the record of a map.

    Args:
        found: computed map.
        numbers: result of `rig map --json`.
    """
    question, grid = found.question, found.grid
    arrays: dict[str, NDArray[Any]] = {
        "multiplier_max": grid.multiplier_max,
        "error_estimate": grid.error_estimate,
        "decay_rate_per_s": grid.decay_rate_per_s,
    }
    if found.computed is not None:
        arrays["computed"] = found.computed
    lines = _lines(found.borders, None)
    for member in found.family:
        lines += _lines(member.borders, member.value)
    return MapRecord(_provenance(question, found.method, numbers), grid.x, grid.y, arrays, lines)


def motion_record(found: StateMap | CoexistenceMap, borders: Borders | None, numbers: Mapping[str, Any]) -> MapRecord:
    """Return the record of a map of motions: the arrays of `states_at` or of `motions_at`.

    Args:
        found: computed map.
        borders: borders of the balanced state's stability.
        numbers: result of `rig map --json`.
    """
    arrays: dict[str, NDArray[Any]] = dict(found.arrays)
    method = "stable motions by Newton's method and their own multipliers"
    if isinstance(found, StateMap):
        method = f"a release at every point, followed for {found.question.seconds:g} s"
        if found.computed is not None:
            arrays["computed"] = found.computed
    return MapRecord(_provenance(found.question, method, numbers), found.x, found.y, arrays, _lines(borders, None))


def _lines(borders: Borders | None, value: float | None) -> tuple[RecordedBorder, ...]:
    branches = borders.branches if borders else ()
    return tuple(RecordedBorder(b.x, b.y, b.multiplier, b.closed, value) for b in branches)


def _provenance(question: MapQuestion, method: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
    known = question.parameters
    return {
        "format": FORMAT,
        "software": "pendulum-balancer-rig",
        "software_version": software_version(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "rig": question.loaded().name,
        "rig_digest": question.rig.digest,
        "parameters": None if known is None else known.source,
        "parameters_digest": None if known is None else known.digest,
        "settings": list(question.settings),
        "method": method,
        "accuracy": question.accuracy,
        "question": question.as_json(),
        "found": dict(numbers),
    }
