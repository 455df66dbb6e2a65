"""Maps over two numbers of a rig, in rectangles of about one second of computing time."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
from typing_extensions import override

from analysis.maps.answers import compile_maps
from analysis.maps.question import MapQuestion
from dynamics.stability.map_plane import Plane
from dynamics.stability.stability_map import StabilityMap, stability_map_over
from rig_basics.arrays import Array
from studies.errors import StudyInputError
from studies.study import Answer, Kind, Study
from studies.tile_files import TileFolder
from studies.tiling import Part, parts_of

_MAX_TILE_POINTS = 131_072  # about one second of one processor
_MAX_COLUMNS = 400
_MAX_MAP_POINTS = 200_000_000


def map_study(question: MapQuestion) -> Study:
    """Return the study of a map's grid; refined grids and borders are not computed in tiles.

    Raises:
        StudyInputError: the map has too many points for the memory.
    """
    count = question.x.count * question.y.count
    if count > _MAX_MAP_POINTS:
        raise StudyInputError(
            f"a map has at most {_MAX_MAP_POINTS:.0e} points, all of which are in memory at the end; got "
            f"{question.x.count} × {question.y.count}. Compute parts of the plane, one after the other"
        )
    alone = replace(question, quantity="multiplier", borders=False, refine=0, family=None, best=None)
    return Study.of("map", alone.as_json())


@lru_cache(maxsize=8)
def _parsed(text: str) -> tuple[MapQuestion, list[Part]]:
    """Return the question and its tiles."""
    question = MapQuestion.of_json(json.loads(text))
    return question, parts_of(question.x.count, question.y.count, _MAX_COLUMNS, _MAX_TILE_POINTS)


@lru_cache(maxsize=8)
def _plane(text: str) -> tuple[Plane, Array, Array]:
    """Return the plane and the values of its numbers."""
    question = _parsed(text)[0]
    return question.plane(), question.x.values, question.y.values


class Maps(Kind):
    """Kind of study: `multiplier_max`, `error_estimate`, shape (rows, columns), and points by method of a rectangle."""

    uses_threads = True

    @override
    def tiles(self, text: str) -> int:
        return len(_parsed(text)[1])

    @override
    def part(self, text: str, tile: int) -> None:
        """Return None: the tile's number is sufficient."""

    @override
    def warm_up(self, text: str) -> None:
        compile_maps(_parsed(text)[0])

    @override
    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Compute one rectangle."""
        rows, columns = _parsed(text)[1][tile]
        plane, x, y = _plane(text)
        accuracy = _parsed(text)[0].accuracy
        found = stability_map_over(plane, x[columns], y[rows], accuracy, threads=threads)
        return {
            "multiplier_max": found.multiplier_max,
            "error_estimate": found.error_estimate,
            "counts": np.array(found.counts),
        }


def assembled(folder: TileFolder) -> tuple[MapQuestion, StabilityMap]:
    """Assemble the map of a folder with all tiles.

    Raises:
        FolderFault: a tile is damaged or missing.
    """
    text = folder.study.text
    question, parts = _parsed(text)
    plane, x, y = _plane(text)
    found, errors = np.empty((len(y), len(x))), np.empty((len(y), len(x)))
    counts = np.zeros(3, int)
    for tile, part in enumerate(parts):
        answer = folder.read(tile)
        found[part], errors[part] = answer["multiplier_max"], answer["error_estimate"]
        counts += answer["counts"]
    interpolated, explicit, one_by_one = map(int, counts)
    return question, StabilityMap(plane, x, y, found, errors, (interpolated, explicit, one_by_one), question.accuracy)


KIND = Maps()
