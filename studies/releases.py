"""End states of releases over two numbers of a rig; a tile contains a few points."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from analysis.maps.question import MapQuestion
from analysis.maps.states import ARRAYS, Indices, StateMap, refined_states, states_at
from dynamics.stability.map_plane import Plane
from studies.errors import StudyInputError
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder

_TILE_POINTS = 24  # one or two seconds of computing time
_MAX_MAP_POINTS = 10_000_000
_MAX_LISTED = 10_000  # points of a refined grid in one study, whose question contains their indices


def release_study(question: MapQuestion) -> Study:
    """Return the study of the releases of a map's whole grid.

    Raises:
        StudyInputError: the map has too many points for the memory.
    """
    if question.x.count * question.y.count > _MAX_MAP_POINTS:
        raise StudyInputError(
            f"a map of releases has at most {_MAX_MAP_POINTS:.0e} points, got {question.x.count} × "
            f"{question.y.count}; compute fewer, or parts of the plane"
        )
    return Study.of("releases", _question_of(replace(question, refine=0)) | {"at": None})


def listed_study(question: MapQuestion, columns: Indices, rows: Indices) -> Study:
    """Return the study of the releases of some points of a question's finest grid.

    Args:
        question: question with the grid.
        columns, rows: indices of the points, at most 10 000.
    """
    number = len(question.fine[0].values)
    at: list[int] = (np.asarray(rows, np.int64) * number + columns).tolist()
    return Study.of("releases", _question_of(question) | {"at": at})


def refined(question: MapQuestion, run: Callable[[Study], TileFolder]) -> tuple[StateMap, list[Study]]:
    """Compute a map that is refined where the state changes, in lists of points.

    Args:
        question: question with the grid.
        run: runs a study; finished tiles are not computed again.
    Returns:
        The map, and the studies whose tiles it consists of.
    """
    studies = list[Study]()

    def states(columns: Indices, rows: Indices) -> dict[str, NDArray[np.float64]]:
        tiles = list[Answer]()
        for first in range(0, len(rows), _MAX_LISTED):
            part = slice(first, first + _MAX_LISTED)
            studies.append(listed_study(question, columns[part], rows[part]))
            folder = run(studies[-1])
            tiles += [folder.read(tile) for tile in range(studies[-1].tiles)]
        return {name: np.concatenate([tile[name] for tile in tiles]) for name in ARRAYS}

    return refined_states(question, states), studies


def _question_of(question: MapQuestion) -> dict[str, Any]:
    return {"map": replace(question, quantity="state", borders=False, accuracy=1e-8).as_json()}


@lru_cache(maxsize=8)
def _parsed(text: str) -> tuple[MapQuestion, list[int] | None]:
    table = json.loads(text)
    return MapQuestion.of_json(table["map"]), table["at"]


@lru_cache(maxsize=8)
def _points(text: str) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    """Return the plane and its points, row by row or as listed."""
    question, at = _parsed(text)
    axes = (question.x, question.y) if at is None else question.fine
    x, y = (each.ravel() for each in np.meshgrid(*(axis.values for axis in axes)))
    return (question.plane(), x, y) if at is None else (question.plane(), x[at], y[at])


class ReleaseStudy(Kind):
    """Kind of study: arrays of `analysis.maps.states.states_at`, shape (points,)."""

    uses_threads = True

    @override
    def tiles(self, text: str) -> int:
        question, at = _parsed(text)
        return -(-(question.x.count * question.y.count if at is None else len(at)) // _TILE_POINTS)

    @override
    def part(self, text: str, tile: int) -> None:
        """Return None: the tile's number is sufficient."""

    @override
    def warm_up(self, text: str) -> None:
        plane, x, y = _points(text)
        states_at(plane, x[:1], y[:1], 1.0, 1)

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Compute the releases of one tile."""
        plane, x, y = _points(text)
        part = slice(tile * _TILE_POINTS, (tile + 1) * _TILE_POINTS)
        return dict(states_at(plane, x[part], y[part], _parsed(text)[0].seconds, threads))


def assembled(folder: TileFolder, question: MapQuestion) -> StateMap:
    """Assemble the map of a folder with all tiles.

    Args:
        folder: folder with all tiles.
        question: complete question, borders and quantity included.
    Raises:
        FolderFault: a tile is damaged or missing.
    """
    tiles = [folder.read(tile) for tile in range(folder.study.tiles)]
    shape = question.y.count, question.x.count
    arrays = {name: np.concatenate([tile[name] for tile in tiles]).reshape(shape) for name in ARRAYS}
    return StateMap(question, question.x.values, question.y.values, arrays)


KIND = ReleaseStudy()
