# pyright: strict
"""Maps over two numbers of a rig, in rectangles of about a second."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.maps.answers import compile_maps
from analysis.maps.question import MapQuestion
from dynamics.stability.map_plane import Plane
from dynamics.stability.stability_map import StabilityMap, plane_map
from studies.errors import StudyInputError
from studies.study import Answer, Study
from studies.tile_files import TileFolder
from studies.tiling import Part, parts_of

_MOST_POINTS = 131_072  # of a tile: about a second of one processor
_MOST_COLUMNS = 400
_LARGEST = 200_000_000  # points of a map


def map_study(question: MapQuestion) -> Study:
    """The study that works out the grid of a map's question; refined grids and borders are not in tiles.

    Raises:
        StudyInputError: more points than can be put together.
    """
    count = question.x.count * question.y.count
    if count > _LARGEST:
        raise StudyInputError(
            f"a map holds at most {_LARGEST:.0e} points, all of which are in memory at the end; asked "
            f"{question.x.count} × {question.y.count}. Ask for parts of the plane, one after the other"
        )
    alone = replace(question, quantity="multiplier", borders=False, refine=0, family=None, best=None)
    return Study.of("map", alone.as_json())


@lru_cache(maxsize=8)
def _asked(text: str) -> tuple[MapQuestion, list[Part]]:
    """The question and its tiles."""
    question = MapQuestion.of_json(json.loads(text))
    return question, parts_of(question.x.count, question.y.count, _MOST_COLUMNS, _MOST_POINTS)


@lru_cache(maxsize=8)
def _plane(text: str) -> tuple[Plane, NDArray[np.floating], NDArray[np.floating]]:
    """The plane and the values of its numbers."""
    question = _asked(text)[0]
    return question.plane(), question.x.values, question.y.values


class Maps:
    """See Kind: `multiplier_max` and `error_estimate` of a rectangle, shape (rows, columns), and how they were had."""

    uses_threads = True

    def tiles(self, text: str) -> int:
        """See Kind."""
        return len(_asked(text)[1])

    def part(self, text: str, tile: int) -> None:
        """See Kind: a tile's number says it."""

    def warm_up(self, text: str) -> None:
        """See Kind."""
        compile_maps(_asked(text)[0])

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """See Kind."""
        rows, columns = _asked(text)[1][tile]
        plane, x, y = _plane(text)
        accuracy = _asked(text)[0].accuracy
        found = plane_map(plane, x[columns], y[rows], accuracy, threads=threads)
        return {
            "multiplier_max": found.multiplier_max,
            "error_estimate": found.error_estimate,
            "counts": np.array(found.counts),
        }


def assembled(folder: TileFolder) -> tuple[MapQuestion, StabilityMap]:
    """The whole map of a folder that has every tile.

    Raises:
        FolderFault: a tile is damaged or missing.
    """
    text = folder.study.text
    question, parts = _asked(text)
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
