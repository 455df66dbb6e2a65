# pyright: strict
"""A map's question answered: the largest multipliers on its grid, and the borders of stability."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from analysis.maps.question import MapQuestion
from dynamics.stability.borders import Borders, stability_borders
from dynamics.stability.map_tiles import compile_tiles
from dynamics.stability.stability_map import StabilityMap, plane_map

Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Begins to show a piece of work, and takes the share of it that is done."""


@dataclass(frozen=True)
class MapAnswer:
    """What was found.

    Attributes:
        question: what was asked.
        grid: the largest multipliers.
        borders: None where none were asked for.
        seconds: that the grid took.
    """

    question: MapQuestion
    grid: StabilityMap
    borders: Borders | None
    seconds: float


def compile_maps(question: MapQuestion) -> None:
    """Have the code of maps compiled, which a first answer would wait for.

    Raises:
        RigFileError, DynamicsError: the question has no answer.
    """
    plane_map(question.plane(), question.x.values[:1], question.y.values[:1], question.accuracy)
    compile_tiles()


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
    shown = progress or _unseen
    plane, x, y = question.plane(), question.x, question.y
    started = time.perf_counter()
    if grid_of is not None:
        grid = grid_of()
    else:
        with shown(f"{x.count * y.count} points") as told:
            grid = plane_map(plane, x.values, y.values, question.accuracy, told)
    seconds, borders = time.perf_counter() - started, None
    if question.borders:
        with shown("borders") as told:
            logarithmic = x.logarithmic, y.logarithmic
            borders = stability_borders(plane, x.span, y.span, logarithmic=logarithmic, progress=told)
    return MapAnswer(question, grid, borders, seconds)


def _unseen(text: str) -> AbstractContextManager[Callable[[float], None]]:
    del text
    return nullcontext(_unheard)


def _unheard(share: float) -> None:
    del share
