# pyright: strict
"""Which stable motions coexist over two numbers of a rig, a rectangle of neighbours to a tile."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.maps.coexistence import COEXISTENCE_ARRAYS, CoexistenceMap, motions_at
from analysis.maps.question import MapQuestion
from dynamics.stability.map_plane import Plane
from studies.study import Answer, Study
from studies.tile_files import TileFolder
from studies.tiling import Part, parts_of

_WIDE, _POINTS = 8, 32  # columns and points of a tile: slipping orbits are carried to neighbours within it


def coexistence_study(question: MapQuestion) -> Study:
    """The study that answers a question of coexisting motions."""
    alone = replace(question, quantity="coexisting", borders=False, refine=0, accuracy=1e-8, seconds=20.0)
    return Study.of("coexistence", alone.as_json())


@lru_cache(maxsize=8)
def _asked(text: str) -> tuple[MapQuestion, list[Part]]:
    question = MapQuestion.of_json(json.loads(text))
    return question, parts_of(question.x.count, question.y.count, _WIDE, _POINTS)


@lru_cache(maxsize=8)
def _plane(text: str) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    question = _asked(text)[0]
    return question.plane(), question.x.values, question.y.values


class Coexistence:
    """See Kind: the arrays of `analysis.maps.coexistence.motions_at`, shape (rows, columns)."""

    uses_threads = True

    def tiles(self, text: str) -> int:
        """See Kind."""
        return len(_asked(text)[1])

    def part(self, text: str, tile: int) -> None:
        """See Kind: a tile's number says it."""

    def warm_up(self, text: str) -> None:
        """See Kind."""
        plane, x, y = _plane(text)
        motions_at(plane, x[:1], y[:1], workers=1)

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """See Kind."""
        plane, x, y = _plane(text)
        rows, columns = _asked(text)[1][tile]
        grid = np.meshgrid(x[columns], y[rows])
        found = motions_at(plane, grid[0].ravel(), grid[1].ravel(), len(x[columns]), threads)
        return {name: values.reshape(grid[0].shape) for name, values in found.items()}


def assembled(folder: TileFolder, question: MapQuestion) -> CoexistenceMap:
    """The whole map of a folder that has every tile.

    Args:
        question: as it was asked, borders included.
    Raises:
        FolderFault: a tile is damaged or missing.
    """
    arrays = {name: np.empty((question.y.count, question.x.count)) for name in COEXISTENCE_ARRAYS}
    for tile, part in enumerate(_asked(folder.study.text)[1]):
        answer = folder.read(tile)
        for name, values in arrays.items():
            values[part] = answer[name]
    return CoexistenceMap(question, question.x.values, question.y.values, arrays)


KIND = Coexistence()
