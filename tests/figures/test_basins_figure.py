"""The figure of a basin map: cells by end, borders between them, boundary cells hatched, the legend."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection

from analysis.figures.basins import colour_of, draw_basins
from dynamics.steady.basins.basin_map import BasinMap
from dynamics.steady.basins.ends import End
from tests.figures.drawn_texts import drawn_texts, faults


def _map() -> BasinMap:
    state = np.zeros(8)
    ends = tuple(End("I", i, (1.89 + 2.5 * i, 4.39 - 2.5 * i), 0.0, 0.9, state, None) for i in (0, 1))
    end = np.array([[0, 0, 1, 1], [0, -1, 1, 1], [0, 0, 0, 1]])
    sure = np.ones((3, 4), dtype=bool)
    sure[1, 1:3] = False
    sure[2, 3] = False
    times = np.where(end < 0, math.nan, 10.0 + np.arange(12).reshape(3, 4))
    three, four = np.radians([-135.0, -45.0, 45.0, 135.0]), np.radians([60.0, 180.0, 300.0])
    return BasinMap(
        three,
        four,
        ends,
        end,
        sure,
        times,
        times,
        np.zeros((3, 4)),
        np.zeros((3, 4)),
        np.zeros((3, 4, 2)),
        20.0,
        1e-6,
        60.0,
    )


def test_cells_borders_hatches_and_words():
    found = _map()
    figure = draw_basins(found, "a rig, Ω = 1.6")
    left = figure.axes[0]
    (borders,) = [c for c in left.collections if isinstance(c, LineCollection)]
    assert len(borders.get_segments()) == 7  # sides between cells that end differently
    (hatched,) = [c for c in left.collections if isinstance(c, PolyCollection)]
    assert hatched.get_hatch() == "////"
    boxes = [path.get_extents().bounds for path in hatched.get_paths()]
    assert np.allclose(boxes, [(-90, 120, 180, 120), (90, 240, 90, 120)])  # two neighbours in one
    texts = [each.text for each in drawn_texts(figure)]
    for words in (
        "I: A at 108.3°, B at 251.5° · 50.0 %",
        "not settled within 20 s · 8.3 %",
        "at a boundary: ± 6e-05° may change the end · 25.0 %",
        "a rig, Ω = 1.6",
    ):
        assert words in texts
    assert faults(figure) == []


def test_mirror_images_have_colours_of_their_own():
    one, other = _map().ends
    assert colour_of(one) != colour_of(other)
