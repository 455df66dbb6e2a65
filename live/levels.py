"""One signal with its history: samples, and minima and maxima of longer intervals, in bounded memory.

A chart requests as many buckets as it has pixels. Up to two samples per bucket are returned unchanged. Otherwise the
minimum and maximum of every bucket are returned, and the chart displays that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig_basics.arrays import Array

KEPT = 2**18
"""Samples of a displacement that are kept: 65 s at 4 kHz."""
KEPT_SLOW = 2**16
"""Samples of other signals: 65 s at 1 kHz, 11 min at 100 Hz. A larger memory would take an hour to fill."""
_FACTORS = (64, 4096)  # samples per pair of the reduced levels
_KEPT_PAIRS = 2**16  # per level: 17 min and 18 h at 4 kHz
_MAX_ROWS_PER_BUCKET = 64  # rows per bucket above which a more reduced level is used
_BREAK_RATIO = 4.0  # gap over the median distance of samples above which a line is interrupted


@dataclass(frozen=True)
class ChartRows:
    """Rows of one signal for a chart.

    Attributes:
        time_s: time of each row, ascending, shape (n,).
        low, high: minimum and maximum, shape (n,); equal if rows are samples. NaN where the line is interrupted.
        bucket_s: width of the bucket of a row, s; 0 if rows are samples.
    """

    time_s: Array
    low: Array
    high: Array
    bucket_s: float = 0.0


def decimate(time_s: Array, low: Array, high: Array, start_s: float, end_s: float, buckets: int) -> ChartRows:
    """Reduce a window to the minimum and maximum of every bucket; few rows are returned unchanged.

    Args:
        time_s: times, ascending, shape (n,).
        low, high: minimum and maximum, shape (n,); the same array for samples. NaN: no value.
        start_s, end_s: start and end of the window, start < end. Buckets begin at multiples of their width, so that a
            moving picture does not flicker.
        buckets: number of buckets, at least 1.
    """
    samples = low is high
    first, end = np.searchsorted(time_s, (start_s, end_s))
    time_s, low, high = time_s[first:end], low[first:end], high[first:end]
    if (samples and len(time_s) <= 2 * buckets) or len(time_s) == 0:
        return _samples(time_s, low, high)
    width = (end_s - start_s) / buckets
    number = np.floor(time_s / width).astype(np.int64)
    begins = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    lows = np.fmin.reduceat(low, begins)
    highs = np.fmax.reduceat(high, begins)
    middles = np.asarray((number[begins] + 0.5) * width, dtype=np.float64)
    waits = time_s[begins[1:]] - time_s[begins[1:] - 1]  # from a bucket's last row to the next one's first
    if len(waits):
        at = np.flatnonzero(waits > max(width, _longest_wait(np.diff(time_s)))) + 1
        middles = np.insert(middles, at, middles[at - 1] + 0.5 * width)
        lows, highs = np.insert(lows, at, np.nan), np.insert(highs, at, np.nan)
    return ChartRows(middles, lows, highs, width)


def _samples(time_s: Array, low: Array, high: Array) -> ChartRows:
    if len(time_s) > 2:
        steps = np.diff(time_s)
        at = np.flatnonzero(steps > _longest_wait(steps)) + 1
        if len(at):
            between = time_s[at - 1] + 1e-6
            return ChartRows(np.insert(time_s, at, between), np.insert(low, at, np.nan), np.insert(high, at, np.nan))
    return ChartRows(time_s, low, high)


def _longest_wait(steps: Array) -> float:
    """Return the longest time between samples that interrupts no line; samples of one read may have the same time."""
    apart = steps[steps > 0]
    return _BREAK_RATIO * float(np.median(apart)) if len(apart) else np.inf


class _Rows:
    """Newest rows of (time, low, high) in one block of memory, which are moved to its start when it is full."""

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._table = np.empty((3, min(2 * kept, 4096)))
        self.end = 0
        self.dropped = False

    def add(self, time_s: Array, low: Array, high: Array) -> None:
        count = len(time_s)
        if self.end + count > self._table.shape[1]:
            self._make_room(count)
        self._table[0, self.end : self.end + count] = time_s
        self._table[1, self.end : self.end + count] = low
        self._table[2, self.end : self.end + count] = high
        self.end += count

    def _make_room(self, count: int) -> None:
        kept = min(self.end, self._kept)
        self.dropped = self.dropped or kept < self.end
        rows = self._table[:, self.end - kept : self.end]
        size = max(self._table.shape[1], min(2 * (kept + count), 2 * self._kept), kept + count)
        table = np.empty((3, size))
        table[:, :kept] = rows
        self._table, self.end = table, kept

    @property
    def time_s(self) -> Array:
        return self._table[0, : self.end]

    @property
    def low(self) -> Array:
        return self._table[1, : self.end]

    @property
    def high(self) -> Array:
        return self._table[2, : self.end]


class Levels:
    """Samples and reduced levels of one signal.

    Args:
        kept: number of samples that are kept.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._samples = _Rows(kept)
        self._longer = [_Rows(max(_KEPT_PAIRS, kept // factor + 1)) for factor in _FACTORS]
        self._waiting = [np.empty((2, 0)) for _ in _FACTORS]

    def add(self, time_s: Array, values: Array) -> None:
        """Append samples, shape (n,) each, later than all earlier ones; NaN: no value."""
        if not len(time_s):
            return
        self._samples.add(time_s, values, values)
        for i, (factor, rows) in enumerate(zip(_FACTORS, self._longer, strict=True)):
            waiting = np.hstack([self._waiting[i], np.vstack([time_s, values])])
            whole = waiting.shape[1] // factor * factor
            if whole:
                blocks = waiting[:, :whole].reshape(2, -1, factor)
                rows.add(blocks[0, :, 0], np.fmin.reduce(blocks[1], 1), np.fmax.reduce(blocks[1], 1))
            self._waiting[i] = waiting[:, whole:].copy()

    @property
    def newest_s(self) -> float:
        """Time of the newest sample; -inf without samples."""
        return float(self._samples.time_s[-1]) if self._samples.end else -np.inf

    def until(self, at_s: float) -> float:
        """Return the time of the newest sample not after an instant; -inf without one."""
        place = int(np.searchsorted(self._samples.time_s, at_s, side="right"))
        return float(self._samples.time_s[place - 1]) if place else -np.inf

    def between(self, start_s: float, end_s: float) -> tuple[Array, Array]:
        """Return times and values of the kept samples with start < time ≤ end."""
        first, end = np.searchsorted(self._samples.time_s, (start_s, end_s), side="right")
        return self._samples.time_s[first:end].copy(), self._samples.low[first:end].copy()

    def last(self, at_s: float) -> float:
        """Return the newest value not after an instant; NaN without one."""
        place = int(np.searchsorted(self._samples.time_s, at_s, side="right"))
        return float(self._samples.low[place - 1]) if place else np.nan

    def stretch(self, start_s: float, end_s: float, buckets: int) -> ChartRows:
        """Return the signal in a window for a chart of `buckets` pixels."""
        samples = self._samples
        reaches = not samples.dropped or (samples.end > 0 and samples.time_s[0] <= start_s)
        if reaches:
            first, end = np.searchsorted(samples.time_s, (start_s, end_s))
            if end - first <= _MAX_ROWS_PER_BUCKET * 2 * buckets:
                values = samples.low
                return decimate(samples.time_s, values, values, start_s, end_s, buckets)
        chosen = len(self._longer) - 1
        for i, longer in enumerate(self._longer):
            first, end = np.searchsorted(longer.time_s, (start_s, end_s))
            if end - first <= _MAX_ROWS_PER_BUCKET * buckets and (not longer.dropped or longer.time_s[0] <= start_s):
                chosen = i
                break
        return decimate(*self._pairs(chosen, start_s), start_s, end_s, buckets)

    def _pairs(self, level: int, start_s: float) -> tuple[Array, Array, Array]:
        """Return minima and maxima of a reduced level from an instant on, including the incomplete last pair."""
        rows, waiting = self._longer[level], self._waiting[level]
        first = int(np.searchsorted(rows.time_s, start_s))
        time_s, low, high = rows.time_s[first:], rows.low[first:], rows.high[first:]
        if waiting.shape[1]:
            time_s = np.append(time_s, waiting[0, 0])
            low, high = np.append(low, np.fmin.reduce(waiting[1])), np.append(high, np.fmax.reduce(waiting[1]))
        return time_s, low, high
