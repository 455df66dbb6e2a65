# pyright: strict
"""What releases come to over two numbers of a rig, a few points to a tile."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.maps.question import MapQuestion
from analysis.maps.states import ARRAYS, Indices, StateMap, refined_states, states_at
from dynamics.stability.map_plane import Plane
from studies.errors import StudyInputError
from studies.study import Answer, Study
from studies.tile_files import TileFolder

_POINTS = 24  # of a tile: a second or two
_LARGEST = 10_000_000  # points of a map
_MOST_LISTED = 10_000  # points of a refined grid in one study, whose question lists them


def release_study(question: MapQuestion) -> Study:
    """The study that follows the releases of a map's whole grid.

    Raises:
        StudyInputError: more points than can be put together.
    """
    if question.x.count * question.y.count > _LARGEST:
        raise StudyInputError(
            f"a map of releases has at most {_LARGEST:.0e} points, asked {question.x.count} × {question.y.count}; ask "
            "for fewer, or for parts of the plane"
        )
    return Study.of("releases", _question_of(replace(question, refine=0)) | {"at": None})


def listed_study(question: MapQuestion, columns: Indices, rows: Indices) -> Study:
    """The study that follows the releases of some points of a question's finest grid.

    Args:
        columns, rows: of the points, at most 10 000.
    """
    number = len(question.fine[0].values)
    at: list[int] = (np.asarray(rows, np.int64) * number + columns).tolist()
    return Study.of("releases", _question_of(question) | {"at": at})


def refined(question: MapQuestion, worked_out: Callable[[Study], TileFolder]) -> tuple[StateMap, list[Study]]:
    """A map refined where the state changes, point list by point list.

    Args:
        worked_out: works a study out; what is there already is not worked out again.
    Returns:
        The map, and the studies whose tiles it is made of.
    """
    studies = list[Study]()

    def states(columns: Indices, rows: Indices) -> dict[str, NDArray[np.float64]]:
        tiles = list[Answer]()
        for first in range(0, len(rows), _MOST_LISTED):
            part = slice(first, first + _MOST_LISTED)
            studies.append(listed_study(question, columns[part], rows[part]))
            folder = worked_out(studies[-1])
            tiles += [folder.read(tile) for tile in range(studies[-1].tiles)]
        return {name: np.concatenate([tile[name] for tile in tiles]) for name in ARRAYS}

    return refined_states(question, states), studies


def _question_of(question: MapQuestion) -> dict[str, Any]:
    return {"map": replace(question, quantity="state", borders=False, accuracy=1e-8).as_json()}


@lru_cache(maxsize=8)
def _asked(text: str) -> tuple[MapQuestion, list[int] | None]:
    asked = json.loads(text)
    return MapQuestion.of_json(asked["map"]), asked["at"]


@lru_cache(maxsize=8)
def _points(text: str) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    """The plane and its points, row by row or as they are listed."""
    question, at = _asked(text)
    axes = (question.x, question.y) if at is None else question.fine
    x, y = (each.ravel() for each in np.meshgrid(*(axis.values for axis in axes)))
    return (question.plane(), x, y) if at is None else (question.plane(), x[at], y[at])


class Releases:
    """See Kind: the arrays of `analysis.maps.states.states_at`, shape (points,)."""

    uses_threads = True

    def tiles(self, text: str) -> int:
        """See Kind."""
        question, at = _asked(text)
        return -(-(question.x.count * question.y.count if at is None else len(at)) // _POINTS)

    def part(self, text: str, tile: int) -> None:
        """See Kind: a tile's number says it."""

    def warm_up(self, text: str) -> None:
        """See Kind."""
        plane, x, y = _points(text)
        states_at(plane, x[:1], y[:1], 1.0, 1)

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """See Kind."""
        plane, x, y = _points(text)
        part = slice(tile * _POINTS, (tile + 1) * _POINTS)
        return dict(states_at(plane, x[part], y[part], _asked(text)[0].seconds, threads))


def assembled(folder: TileFolder, question: MapQuestion) -> StateMap:
    """The whole map of a folder that has every tile.

    Args:
        question: as it was asked, borders and quantity included.
    Raises:
        FolderFault: a tile is damaged or missing.
    """
    tiles = [folder.read(tile) for tile in range(folder.study.tiles)]
    shape = question.y.count, question.x.count
    arrays = {name: np.concatenate([tile[name] for tile in tiles]).reshape(shape) for name in ARRAYS}
    return StateMap(question, question.x.values, question.y.values, arrays)


KIND = Releases()
