# pyright: strict
"""A map's question answered: the largest multipliers on its grid, borders of stability, families of them, the best."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.maps.families import BestValue, best_value
from analysis.maps.question import MapQuestion
from analysis.maps.refinement import refined_grid
from analysis.maps.shares import unresolved_share
from dynamics.stability.borders import LEVELS, Borders, stability_borders
from dynamics.stability.map_plane import Plane
from dynamics.stability.map_tiles import compile_tiles
from dynamics.stability.stability_map import StabilityMap, multipliers_at_points, plane_map

Told = Callable[[float], None]
_BORDER_POINTS = 4000  # at least, of a border as long as a side of the map
_FINER = 3  # halvings of the borders' grid, at least one more than it has by itself
_REST = 4 / 3  # what all further halvings change, in what one does: an area by chords converges with the square


class Progress(Protocol):
    """Begins to show a piece of work, and takes the share of it that is done."""

    def __call__(self, text: str, count: float | None = None, unit: str = "") -> AbstractContextManager[Told]:
        """The text says what is done; all of it is so many of a unit, None where nothing is counted."""
        ...


@dataclass(frozen=True)
class FamilyMember:
    """The borders for one value of a family's number.

    Attributes:
        unresolved: share of the plane about which they say nothing.
    """

    value: float
    borders: Borders
    unresolved: float


@dataclass(frozen=True)
class MapAnswer:
    """What was found.

    Attributes:
        question: what was asked.
        grid: the largest multipliers; of a refined map on its finest grid.
        computed: of a refined map which points of the grid were computed, the others are interpolated and have no error
            estimate, shape (m, n); None where all were.
        borders: of the rig itself; None where none were asked for.
        unresolved: share of the plane about which they say nothing.
        family: borders of each value of a family's number.
        best: where the stable share is greatest; None where it was not asked for.
        seconds: that the grid took.
    """

    question: MapQuestion
    grid: StabilityMap
    computed: NDArray[np.bool_] | None
    borders: Borders | None
    unresolved: float
    family: tuple[FamilyMember, ...]
    best: BestValue | None
    seconds: float

    @property
    def method(self) -> str:
        """How many points which method served."""
        if self.computed is None:
            return self.grid.method
        count, total = int(np.count_nonzero(self.computed)), self.computed.size
        return f"explicit at {count} of {total} points, at borders; interpolated between them elsewhere"


def compile_maps(question: MapQuestion) -> None:
    """Have the code of maps compiled, which a first answer would wait for, and the question's values checked.

    Raises:
        RigFileError, DynamicsError: the question has no answer.
    """
    plane = question.plane()
    plane_map(plane, question.x.values[:1], question.y.values[:1], question.accuracy)
    compile_tiles()
    further = () if question.family is None else question.family.values
    for value in further:
        question.plane(_settings(question.family.keys if question.family else (), value))
    for value in () if question.best is None else (question.best.low, question.best.high):
        question.plane(_settings(question.best.keys if question.best else (), value))


def answer(
    question: MapQuestion, progress: Progress | None = None, grid_of: Callable[[], StabilityMap] | None = None
) -> MapAnswer:
    """Compute a map.

    Args:
        progress: shows how far it is.
        grid_of: works the grid out where it is not to be done at once, here.
    Raises:
        RigFileError, DynamicsError: the question has no answer.
    """
    shown, plane = progress or _unseen, question.plane()
    started = time.perf_counter()
    computed = None
    if question.refine:
        grid, computed = _refined(question, plane, shown)
    else:
        grid = _full(question, plane, shown) if grid_of is None else grid_of()
    seconds = time.perf_counter() - started
    borders, unresolved, members, best = None, 0.0, list[FamilyMember](), None
    if question.borders:
        with shown("borders") as told:
            borders = borders_of(question, plane, told)
        unresolved = unresolved_share(plane, borders, question.axes)
    if (family := question.family) is not None:
        with shown(f"borders for {len(family.values)} values of {family.key}") as told:
            for i, value in enumerate(family.values):
                one = question.plane(_settings(family.keys, value))
                found = borders_of(question, one, _part(told, i, len(family.values)))
                members.append(FamilyMember(value, found, unresolved_share(one, found, question.axes)))
    if question.best is not None:
        with shown(f"best value of {question.best.key}") as told:
            best = _best(question, told)
    return MapAnswer(question, grid, computed, borders, unresolved, tuple(members), best, seconds)


def _full(question: MapQuestion, plane: Plane, shown: Progress) -> StabilityMap:
    count = question.x.count * question.y.count
    with shown(f"{count} points", count, "points") as told:
        return plane_map(plane, question.x.values, question.y.values, question.accuracy, told)


def _refined(question: MapQuestion, plane: Plane, shown: Progress) -> tuple[StabilityMap, NDArray[np.bool_]]:
    x, y = (axis.values for axis in question.fine)
    errors = np.full((len(y), len(x)), np.nan)

    def evaluate(at_x: NDArray[np.float64], at_y: NDArray[np.float64]) -> NDArray[np.float64]:
        found, bounds = multipliers_at_points(plane, at_x, at_y, question.accuracy)
        errors[np.searchsorted(y, at_y), np.searchsorted(x, at_x)] = bounds
        return np.asarray(found, np.float64)

    with shown(f"{question.x.count * question.y.count} points and what lies between them at borders") as told:
        found = refined_grid(evaluate, x, y, question.refine, _classes, progress=told)
    counts = 0, int(np.count_nonzero(found.computed)), 0
    return StabilityMap(plane, x, y, found.values, errors, counts, question.accuracy), found.computed


def _classes(multipliers: NDArray[np.float64]) -> NDArray[np.intp]:
    """Stable, unstable, without a balanced state."""
    return np.where(np.isnan(multipliers), 2, multipliers < 1.0).astype(np.intp)


def borders_of(question: MapQuestion, plane: Plane, told: Told, levels: int = LEVELS) -> Borders:
    """The borders of stability over a question's plane, as fine as its map.

    Args:
        levels: halvings of the first grid's cells, see `stability_borders`.
    """
    x, y = question.axes
    logarithmic = x.logarithmic, y.logarithmic
    spacing = 1 / max(_BORDER_POINTS, x.count, y.count)  # no wider than the map's pitch
    return stability_borders(
        plane, x.span, y.span, levels=levels, spacing=spacing, logarithmic=logarithmic, progress=told
    )


def _best(question: MapQuestion, told: Told) -> BestValue:
    within = question.best
    assert within is not None
    shares = dict[float, float]()

    def share(value: float) -> tuple[float, float]:
        plane = question.plane(_settings(within.keys, value))
        found = borders_of(question, plane, _unheard)
        shares[value] = found.stable_share
        return found.stable_share, unresolved_share(plane, found, question.axes)

    def error(value: float) -> float:
        plane = question.plane(_settings(within.keys, value))
        return _REST * abs(borders_of(question, plane, _unheard, levels=_FINER).stable_share - shares[value])

    return best_value(share, error, within, told)


def _settings(keys: tuple[str, ...], value: float) -> list[str]:
    return [f"{key}={value!r}" for key in keys]


def _part(told: Told, i: int, count: int) -> Told:
    return lambda share: told((i + share) / count)


def _unseen(text: str, count: float | None = None, unit: str = "") -> AbstractContextManager[Told]:
    del text, count, unit
    return nullcontext(_unheard)


def _unheard(share: float) -> None:
    del share
