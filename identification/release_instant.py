"""Where a free decay begins in a record that also holds quiet, a pull and a hold."""

from __future__ import annotations

import numpy as np

from identification.errors import NotIdentifiable
from identification.samples import Averages

_WINDOW_S = 0.06


def release_instant(channels: list[Averages]) -> float:
    """A time surely at or after the release, s.

    The last stretch of 60 ms in which every channel stays level (within 3 % of the largest displacement) while one
    is far from rest is the end of the hold: at any frequency above 2 Hz a free oscillation near its peak moves more.
    Without a hold (the record starts in free decay) it is the record's start.

    Args:
        channels: one or two channels, block averages on one clock.
    Raises:
        NotIdentifiable: nothing moves.
    """
    rests = [float(np.median(c.value[3 * len(c.value) // 4 :])) for c in channels]
    moves = [np.abs(c.value - rest) for c, rest in zip(channels, rests, strict=True)]
    largest = max(float(m.max()) for m in moves)
    noise = max(c.noise / np.sqrt(np.median(c.count)) for c in channels)
    if largest < 12 * noise:
        raise NotIdentifiable(
            f"nothing rings down: the largest displacement, {largest:.2g} m, is not 12 times the noise {noise:.2g} m"
        )
    start = max(c.time_s[0] for c in channels)
    end = min(c.time_s[-1] for c in channels)
    edges = np.arange(start, end - _WINDOW_S, _WINDOW_S / 4)
    level = np.ones(len(edges), bool)
    away = np.zeros(len(edges), bool)
    for channel, move in zip(channels, moves, strict=True):
        first = np.searchsorted(channel.time_s, edges)
        last = np.searchsorted(channel.time_s, edges + _WINDOW_S)
        for i, (a, b) in enumerate(zip(first, last, strict=True)):
            if b - a < 3:
                level[i] = False
                continue
            part = channel.value[a:b]
            level[i] &= part.max() - part.min() < 0.03 * largest + 6 * noise
            away[i] |= float(np.median(move[a:b])) > 0.3 * largest
    held = np.flatnonzero(level & away)
    if len(held) == 0:
        return float(start)
    return float(edges[held[-1]] + _WINDOW_S + 0.015)
