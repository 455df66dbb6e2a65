# pyright: strict
"""What releases come to over two numbers of a rig, a few points to a tile."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.maps.question import MapQuestion
from analysis.maps.states import ARRAYS, StateMap, states_at
from dynamics.stability.map_plane import Plane
from studies.errors import StudyInputError
from studies.study import Answer, Study
from studies.tile_files import TileFolder

_POINTS = 24  # of a tile: a second or two
_LARGEST = 10_000_000  # points of a map


def release_study(question: MapQuestion) -> Study:
    """The study that follows the releases of a map's question; refined grids are not in tiles.

    Raises:
        StudyInputError: more points than can be put together.
    """
    if question.x.count * question.y.count > _LARGEST:
        raise StudyInputError(
            f"a map of releases has at most {_LARGEST:.0e} points, asked {question.x.count} × {question.y.count}; ask "
            "for fewer, or for parts of the plane"
        )
    return Study.of("releases", replace(question, quantity="state", borders=False, refine=0, accuracy=1e-8).as_json())


@lru_cache(maxsize=8)
def _asked(text: str) -> MapQuestion:
    return MapQuestion.of_json(json.loads(text))


@lru_cache(maxsize=8)
def _points(text: str) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    """The plane and its points, row by row."""
    question = _asked(text)
    x, y = np.meshgrid(question.x.values, question.y.values)
    return question.plane(), x.ravel(), y.ravel()


class Releases:
    """See Kind: the arrays of `analysis.maps.states.states_at`, shape (points,)."""

    uses_threads = True

    def tiles(self, text: str) -> int:
        """See Kind."""
        question = _asked(text)
        return -(-question.x.count * question.y.count // _POINTS)

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
        return dict(states_at(plane, x[part], y[part], _asked(text).seconds, threads))


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
