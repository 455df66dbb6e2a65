"""Ctrl-C ends a study while its tiles are in work, and the finished tiles are kept."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.pressed import begun, press_ctrl_c, until
from tests.studies.small_maps import X, Y

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and process groups of POSIX")

# Tile 0 is computed; the others are compiled code without end, which no error can interrupt.
WITHOUT_END = """
import pathlib, numba, numpy as np
from studies.engines import threads

@numba.njit(nogil=True)
def work(numbers):
    while numbers[0] == 0:
        numbers[1] += 1

answer = threads.answer_tile

def answer_tile(kind, text, software, tile, threads=1):
    if tile == 0:
        return answer(kind, text, software, tile, threads)
    numbers = np.zeros(2)
    numbers[0] = 1
    work(numbers)
    pathlib.Path("in work").touch()
    numbers[0] = 0
    work(numbers)

threads.answer_tile = answer_tile
"""


def test_ctrl_c_does_not_wait_for_the_tiles_in_work(tmp_path: Path) -> None:
    tiles = tmp_path / "map.npz.tiles"
    with begun(["map", "virtual", "--x", X, "--y", Y, "-o", "map.npz"], tmp_path, WITHOUT_END) as process:
        until(lambda: (tmp_path / "in work").exists() and any(tiles.glob("*-000000.npz")), process)
        printed = press_ctrl_c(process, tmp_path)
    assert "stopped: 6 tiles" in printed
    assert f"1 of 6 tiles are done and kept in {tiles.name}; the same command continues from there" in printed
    assert [path.name[-10:] for path in tiles.glob("*.npz")] == ["000000.npz"]
