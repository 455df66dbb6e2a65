"""Pendulum angles on the page: numbers and curves within the same turn, curves interrupted at its ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from live.levels import ChartRows

FIRST_DEG = -5.0
"""Lower end of the displayed turn: a pendulum held at 0° does not flicker between the ends of its chart."""


def shown_deg(angle_deg: float) -> float:
    """Return an angle within the displayed turn, FIRST_DEG … FIRST_DEG + 360, °; NaN stays NaN."""
    return float(np.mod(angle_deg - FIRST_DEG, 360.0) + FIRST_DEG)


def within_a_turn(stretch: ChartRows) -> ChartRows:
    """Convert a stretch of an unwrapped angle, °, to the displayed turn.

    The line is interrupted (NaN) where the angle passes FIRST_DEG. A row whose minimum and maximum are on both sides of
    FIRST_DEG is divided into two, one at each end of the chart. A row of a whole turn or more fills the chart.
    """
    low, high = stretch.low, stretch.high
    first, last = (np.floor((angle - FIRST_DEG) / 360.0) for angle in (low, high))
    whole = high - low >= 360.0
    divided = (last > first) & ~whole
    row = np.repeat(np.arange(len(low)), 1 + divided)
    upper = np.diff(row, prepend=-1) == 0  # a divided row's second part
    turn = first[row] + upper
    bottom = np.where(upper | whole[row], FIRST_DEG, low[row] - 360.0 * turn)
    top = np.where((divided[row] & ~upper) | whole[row], FIRST_DEG + 360.0, high[row] - 360.0 * turn)
    turn[whole[row]] = np.nan
    at = np.flatnonzero(turn[1:] != turn[:-1]) + 1
    gap: NDArray[np.float64] = np.full(len(at), np.nan)
    bottom, top = np.insert(bottom, at, gap), np.insert(top, at, gap)
    time_s = np.insert(stretch.time_s[row], at, stretch.time_s[row[at - 1]])
    return ChartRows(time_s, bottom, top, stretch.bucket_s)
