"""Computation of a map: largest multipliers on its grid, borders of stability, families of borders, best value."""

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
from dynamics.stability.stability_map import StabilityMap, multipliers_at_points, stability_map_over
from rig_basics.texts import number_of

ShareProgress = Callable[[float], None]
"""Called with the completed share, 0 … 1."""
_MIN_BORDER_POINTS = 4000  # of a border as long as a side of the map
_ERROR_LEVELS = 3  # halvings of the borders' grid for the error estimate, at least one more than without it
_ERROR_FACTOR = 4 / 3  # change by all further halvings over that by one: the area by chords converges quadratically


class Progress(Protocol):
    """Display of the progress of one piece of work."""

    def __call__(self, text: str, count: float | None = None, unit: str = "") -> AbstractContextManager[ShareProgress]:
        """Begin the display.

        Args:
            text: description of the work.
            count: total amount in `unit`; None if nothing is counted.
            unit: unit of the amount.
        """
        ...


@dataclass(frozen=True)
class FamilyMember:
    """Borders for one value of a family's number.

    Attributes:
        value: value of the number.
        borders: borders of stability with it.
        unresolved: share of the plane that the borders leave undecided.
    """

    value: float
    borders: Borders
    unresolved: float


@dataclass(frozen=True)
class MapAnswer:
    """Computed map.

    Attributes:
        question: question that was answered.
        grid: largest multipliers; of a refined map on its finest grid.
        computed: computed points of a refined map, shape (m, n); the others are interpolated and have no error
            estimate. None if all were computed.
        borders: borders of the rig itself; None if not requested.
        unresolved: share of the plane that the borders leave undecided.
        family: borders for each value of a family's number.
        best: value with the greatest stable share; None if not requested.
        seconds: computing time of the grid, s.
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
        """Method of the grid, with the number of points."""
        if self.computed is None:
            return self.grid.method
        count, total = int(np.count_nonzero(self.computed)), self.computed.size
        return f"explicit at {count} of {number_of(total, 'point')}, at borders; interpolated between them elsewhere"


def compile_maps(question: MapQuestion) -> None:
    """Compile the code of maps in advance, and check the question's values.

    Raises:
        RigFileError, DynamicsError: the question cannot be answered.
    """
    plane = question.plane()
    stability_map_over(plane, question.x.values[:1], question.y.values[:1], question.accuracy)
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
        question: question to be answered.
        progress: display of the progress.
        grid_of: computes the grid elsewhere; None computes it here.
    Raises:
        RigFileError, DynamicsError: the question cannot be answered.
    """
    display, plane = progress or _no_display, question.plane()
    started = time.perf_counter()
    computed = None
    if question.refine:
        grid, computed = _refined(question, plane, display)
    else:
        grid = _full(question, plane, display) if grid_of is None else grid_of()
    seconds = time.perf_counter() - started
    borders, unresolved, members, best = None, 0.0, list[FamilyMember](), None
    if question.borders:
        with display("borders") as notify:
            borders = borders_of(question, plane, notify)
        unresolved = unresolved_share(plane, borders, question.axes)
    if (family := question.family) is not None:
        with display(f"borders for {number_of(len(family.values), 'value')} of {family.key}") as notify:
            for i, value in enumerate(family.values):
                one = question.plane(_settings(family.keys, value))
                found = borders_of(question, one, _part(notify, i, len(family.values)))
                members.append(FamilyMember(value, found, unresolved_share(one, found, question.axes)))
    if question.best is not None:
        with display(f"best value of {question.best.key}") as notify:
            best = _best(question, notify)
    return MapAnswer(question, grid, computed, borders, unresolved, tuple(members), best, seconds)


def _full(question: MapQuestion, plane: Plane, display: Progress) -> StabilityMap:
    count = question.x.count * question.y.count
    with display(number_of(count, "point"), count, "points") as notify:
        return stability_map_over(plane, question.x.values, question.y.values, question.accuracy, notify)


def _refined(question: MapQuestion, plane: Plane, display: Progress) -> tuple[StabilityMap, NDArray[np.bool_]]:
    x, y = (axis.values for axis in question.fine)
    errors = np.full((len(y), len(x)), np.nan)

    def evaluate(at_x: NDArray[np.float64], at_y: NDArray[np.float64]) -> NDArray[np.float64]:
        found, bounds = multipliers_at_points(plane, at_x, at_y, question.accuracy)
        errors[np.searchsorted(y, at_y), np.searchsorted(x, at_x)] = bounds
        return np.asarray(found, np.float64)

    with display(
        f"{number_of(question.x.count * question.y.count, 'point')} and what lies between them at borders"
    ) as notify:
        found = refined_grid(evaluate, x, y, question.refine, _classes, progress=notify)
    counts = 0, int(np.count_nonzero(found.computed)), 0
    return StabilityMap(plane, x, y, found.values, errors, counts, question.accuracy), found.computed


def _classes(multipliers: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return 1 for stable, 0 for unstable, 2 without a balanced state."""
    return np.where(np.isnan(multipliers), 2, multipliers < 1.0).astype(np.intp)


def borders_of(question: MapQuestion, plane: Plane, progress: ShareProgress, levels: int = LEVELS) -> Borders:
    """Follow the borders of stability over a question's plane, as finely as its map.

    Args:
        question: question with the axes.
        plane: rigs over the axes.
        progress: called with the completed share.
        levels: halvings of the first grid's cells, see `stability_borders`.
    """
    x, y = question.axes
    logarithmic = x.logarithmic, y.logarithmic
    spacing = 1 / max(_MIN_BORDER_POINTS, x.count, y.count)  # at most the distance of the map's points
    return stability_borders(
        plane, x.span, y.span, levels=levels, spacing=spacing, logarithmic=logarithmic, progress=progress
    )


def _best(question: MapQuestion, progress: ShareProgress) -> BestValue:
    within = question.best
    assert within is not None
    shares = dict[float, float]()

    def share(value: float) -> tuple[float, float]:
        plane = question.plane(_settings(within.keys, value))
        found = borders_of(question, plane, _ignore)
        shares[value] = found.stable_share
        return found.stable_share, unresolved_share(plane, found, question.axes)

    def error(value: float) -> float:
        plane = question.plane(_settings(within.keys, value))
        finer = borders_of(question, plane, _ignore, levels=_ERROR_LEVELS)
        return _ERROR_FACTOR * abs(finer.stable_share - shares[value])

    return best_value(share, error, within, progress)


def _settings(keys: tuple[str, ...], value: float) -> list[str]:
    return [f"{key}={value!r}" for key in keys]


def _part(progress: ShareProgress, i: int, count: int) -> ShareProgress:
    return lambda share: progress((i + share) / count)


def _no_display(text: str, count: float | None = None, unit: str = "") -> AbstractContextManager[ShareProgress]:
    del text, count, unit
    return nullcontext(_ignore)


def _ignore(share: float) -> None:
    del share
