# pyright: strict
"""A map as files hold it: arrays over x and y, borders as lines, and where all of it is from."""

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
"""Kind and version of the files; a later layout has a later number."""


@dataclass(frozen=True)
class RecordedBorder:
    """One branch.

    Attributes:
        x, y: its points in order, shape (n,); what is stable lies on the left hand.
        multiplier: that crosses the unit circle, complex, shape (n,).
        closed: whether it is an island.
        value: of a family's number; None of the rig itself.
    """

    x: NDArray[np.floating]
    y: NDArray[np.floating]
    multiplier: NDArray[np.complexfloating]
    closed: bool
    value: float | None = None


@dataclass(frozen=True)
class MapRecord:
    """What a file of a map holds.

    Attributes:
        provenance: JSON: format, software and version, date, rig and parameters with their digests, settings, method,
            accuracy, `question` (which `rig map` was asked, rig file included) and what was found in numbers.
        x, y: shapes (n,) and (m,).
        grid: arrays over them, shape (m, n): multiplier_max, error_estimate, decay_rate_per_s, and of a refined map
            `computed`, False where a value is interpolated.
        borders: of the rig itself first, then of each value of a family.
    """

    provenance: Mapping[str, Any]
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    grid: Mapping[str, NDArray[Any]]
    borders: tuple[RecordedBorder, ...] = field(default=())

    @property
    def question(self) -> MapQuestion:
        """What was asked: `analysis.maps.answers.answer` of it makes the map anew."""
        return MapQuestion.of_json(self.provenance["question"])


def record(found: MapAnswer, numbers: Mapping[str, Any]) -> MapRecord:
    """A map to be kept.

    Args:
        numbers: what `rig map --json` says of it.
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
    """A map of motions to be kept: the arrays of `states_at` or of `motions_at`.

    Args:
        borders: of the balanced state's stability.
        numbers: what `rig map --json` says of it.
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
