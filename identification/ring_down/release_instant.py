"""Where a free decay begins in a record that also holds quiet, a pull and a hold."""

from __future__ import annotations

import numpy as np

from identification.errors import NotIdentifiable
from identification.samples import Averages

_WINDOW_S, _MARGIN_S = 0.1, 0.017


def release_instant(channels: list[Averages]) -> float:
    """A time surely at or after the release, s.

    The last stretch of 100 ms in which every channel stays level (within 3 % of the displacement, and noise) far from
    rest is the end of the hold: a free oscillation above 2 Hz moves by a fifth of its amplitude around its peak.
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
    edges = np.arange(start, end - _WINDOW_S, _WINDOW_S / 6)
    middles, ranges = zip(*(_windows(c, m, edges) for c, m in zip(channels, moves, strict=True)), strict=True)
    displaced = np.max(middles, axis=0)
    level = np.max(ranges, axis=0) < 0.03 * displaced + 6 * noise
    held = np.flatnonzero(level & (displaced > 0.5 * largest))
    if len(held) == 0:
        return float(start)
    return float(edges[held[-1]] + _WINDOW_S + _MARGIN_S)


def _windows(channel: Averages, move: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median displacement from rest and range of the values in each window; the range is inf where samples lack."""
    first = np.searchsorted(channel.time_s, edges)
    last = np.searchsorted(channel.time_s, edges + _WINDOW_S)
    middle, spread = np.zeros(len(edges)), np.full(len(edges), np.inf)
    for i, (a, b) in enumerate(zip(first, last, strict=True)):
        if b - a >= 3:
            middle[i] = np.median(move[a:b])
            spread[i] = np.ptp(channel.value[a:b])
    return middle, spread
