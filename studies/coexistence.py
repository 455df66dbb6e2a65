"""Coexisting stable motions over two numbers of a rig; a tile is a rectangle of neighbouring points."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from analysis.maps.coexistence import COEXISTENCE_ARRAYS, CoexistenceMap, motions_at
from analysis.maps.question import MapQuestion
from dynamics.stability.map_plane import Plane
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder
from studies.tiling import Part, parts_of

_MAX_COLUMNS, _MAX_POINTS = 8, 32  # of one tile: slipping orbits are continued to neighbours within it


def coexistence_study(question: MapQuestion) -> Study:
    """Return the study of coexisting motions."""
    alone = replace(question, quantity="coexisting", borders=False, refine=0, accuracy=1e-8, seconds=20.0)
    return Study.of("coexistence", alone.as_json())


@lru_cache(maxsize=8)
def _parsed(text: str) -> tuple[MapQuestion, list[Part]]:
    question = MapQuestion.of_json(json.loads(text))
    return question, parts_of(question.x.count, question.y.count, _MAX_COLUMNS, _MAX_POINTS)


@lru_cache(maxsize=8)
def _plane(text: str) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    question = _parsed(text)[0]
    return question.plane(), question.x.values, question.y.values


class Coexistence(Kind):
    """Kind of study: arrays of `analysis.maps.coexistence.motions_at`, shape (rows, columns)."""

    uses_threads = True

    @override
    def tiles(self, text: str) -> int:
        return len(_parsed(text)[1])

    @override
    def part(self, text: str, tile: int) -> None:
        """Return None: the tile's number is sufficient."""

    @override
    def warm_up(self, text: str) -> None:
        """Compile the code of the motions."""
        plane, x, y = _plane(text)
        motions_at(plane, x[:1], y[:1], workers=1)

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Compute one rectangle."""
        plane, x, y = _plane(text)
        rows, columns = _parsed(text)[1][tile]
        grid = np.meshgrid(x[columns], y[rows])
        found = motions_at(plane, grid[0].ravel(), grid[1].ravel(), len(x[columns]), threads)
        return {name: values.reshape(grid[0].shape) for name, values in found.items()}


def assembled(folder: TileFolder, question: MapQuestion) -> CoexistenceMap:
    """Assemble the map of a folder with all tiles.

    Args:
        folder: folder with all tiles.
        question: complete question, borders included.
    Raises:
        FolderFault: a tile is damaged or missing.
    """
    arrays = {name: np.empty((question.y.count, question.x.count)) for name in COEXISTENCE_ARRAYS}
    for tile, part in enumerate(_parsed(folder.study.text)[1]):
        answer = folder.read(tile)
        for name, values in arrays.items():
            values[part] = answer[name]
    return CoexistenceMap(question, question.x.values, question.y.values, arrays)


KIND = Coexistence()
