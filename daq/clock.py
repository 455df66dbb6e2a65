"""Maps of device clocks to the common clock.

A sample of device time d reaches the host at h = offset + rate·d + delay, where the delay has a lower bound. The least
delayed samples lie on the lower edge of h against d. The line below all points with the least sum of distances (the
edge of the lower convex hull at the mean time) therefore gives offset and rate, up to the constant bound of the delay.

`ClockMap` follows that line causally while recording. Its output is continuous and strictly increasing.
`fit_line` uses a whole log and estimates the standard uncertainty of the rate.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.errors import DeviceError

CLOCK_SEED = "clock_seed"
"""Key of a device's identity: state of the device clock at the start of the log. See `ClockSeed`."""
_SEED_EARLY_NS, _SEED_LATE_NS = 5_000_000, 1_000_000_000
_BIN_NS = 250_000_000
_BINS = 120
_EDGE_READS = 3  # spacings of the least lags of a bin that are averaged: more would leave the edge
_EDGE_STDS = 3.0  # of the spacing, of which the first delay has one; the weights make the line look more certain
_EDGE_DOUBT = 4.1  # spacings by which the least of delays that are sums of three waits lies above their bound
_AVERAGED_BINS = 5  # bins over which spacings are averaged
_LEAST_SPACING_S = 1e-6  # resolution of a host's time stamps
_LINE_ROUNDS = 4  # after which the weights have settled
_MAX_SLEW = 0.5  # largest relative correction of the mapped clock's rate; below 1, so that mapped times increase
_MAX_STRAIGHT_JITTER = 0.15  # mean distance of the least lags from their line, sample periods; a staircase has ≥ 0.25
_EARLY_STEP_NS, _LATE_STEP_NS = 2e5, 20e6  # least steps of the host's clock that are recognised
_EARLY_STDS = 5.0  # standard uncertainties of the line, which a step back exceeds too
_STEP_READS, _STEP_BINS = 20, 4  # reads, and quarters of a second, after which lateness is a step
_STEP_SPREAD = 0.25  # of the least lags in these bins, of the step
_FIRST_STD_NS = 10e6  # of the delay of the first reads
_LEAST_JITTER_NS = 20e3  # wake-up of a thread
_MEMORY = 1 / 64  # weight of a read in the mean lateness
_LEAST_STD_NS = 3e3  # of a time stamp
_LATE_SHARE, _LATE_READS = 0.5, 10  # of the mean lateness, above which each of so many reads shows a delay or a step
_GAPS = 8.0  # standard uncertainty of the line at its newest end, mean lateness over the number of reads
_SETTLE_NS = 300_000_000  # time constant of a correction, short: the error of a delayed first read decays in about 1 s


def lower_line(device: NDArray[np.floating], lag: NDArray[np.floating]) -> tuple[float, float]:
    """Return the line below all points with the least sum of distances.

    It is the edge of the lower convex hull at the mean device time.

    Args:
        device, lag: shape (n,), ascending device time, and host time minus device time in the same unit.
    Returns:
        Lag at device time 0 and slope.
    """
    hull: list[tuple[float, float]] = []
    for x, y in zip(device.tolist(), lag.tolist(), strict=True):
        while len(hull) > 1 and _turn(hull[-2], hull[-1], (x, y)) <= 0:
            hull.pop()
        hull.append((x, y))
    middle = float(np.mean(device))
    last = next((i for i in range(1, len(hull) - 1) if hull[i][0] >= middle), len(hull) - 1)
    (x0, y0), (x1, y1) = hull[max(0, last - 1)], hull[last]
    slope = (y1 - y0) / (x1 - x0) if last else 0.0
    return y0 - slope * x0, slope


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return a positive number if the way from a over b to c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@dataclass(frozen=True)
class ClockSeed:
    """State of a device clock relative to the common clock, estimated before the start of a log.

    Attributes:
        device_ns, host_ns: the same instant on the device clock and on the common clock, ns.
        rate: common seconds per device second, minus 1.
        wrap_ns: period after which the device clock wraps, ns.
    """

    device_ns: int
    host_ns: int
    rate: float
    wrap_ns: int

    @classmethod
    def of(cls, identity: Mapping[str, Any]) -> ClockSeed | None:
        """Return the seed of a device's identity, or None if the identity has none.

        Raises:
            DeviceError: the values of the seed are invalid.
        """
        values = identity.get(CLOCK_SEED)
        if values is None:
            return None
        try:
            seed = cls(**values)
            whole = all(type(ns) is int and abs(ns) < 2**63 for ns in (seed.device_ns, seed.host_ns, seed.wrap_ns))
            if whole and seed.wrap_ns > 0 and type(seed.rate) is float and abs(seed.rate) < _MAX_SLEW:
                return seed
        except TypeError:  # usual: other keys, the same error as wrong values
            pass
        raise DeviceError(f"clocks.json: expected device_ns, host_ns, rate and wrap_ns of a clock, got {values!r:.120}")

    def host_at(self, device_ns: int, near_ns: int) -> int:
        """Return the common time of a device time, ns; of the candidates one wrap apart, the nearest to `near_ns`."""
        ahead = device_ns - self.device_ns
        at_ns = self.host_ns + ahead + round(self.rate * ahead)
        wrap_ns = self.wrap_ns + round(self.rate * self.wrap_ns)
        return at_ns + wrap_ns * round((near_ns - at_ns) / wrap_ns)


_Bin = tuple[int, float, float, int]
"""Number of a bin, time of its least delayed read on the device's clock and its lag, ns, and number of its reads."""


class ClockMap:
    """Causal map of one device clock (ns, unwrapped) to the common clock (ns since 1970).

    A correction is applied at most for its time constant. Samples that are older than earlier samples do not change the
    map. A step of the host's clock (a computer that slept, a clock that was set) starts the estimate again. After a
    step forward the mapped time jumps; after a step back it runs at half its rate until it is right, since it never
    steps back. Nor does it after a new start of the device.

    Args:
        tolerance_ppm: standard uncertainty of the device's rate. The estimated rate is limited to ± 5 of them.
        seed: earlier state of the clock. Without it the first read is assumed to have no delay.

    Attributes:
        step_ns: step of the host's clock against the device's that the newest read has shown, ns; 0 without one.
    """

    def __init__(self, tolerance_ppm: float, seed: ClockSeed | None = None) -> None:
        self._limit = 5e-6 * tolerance_ppm
        self._tolerance = 1e-6 * tolerance_ppm
        self._newest_ns = int(np.iinfo(np.int64).min)  # time of the newest sample so far
        self._before_ns = self._newest_ns  # times after a new start are later than this
        self._start(seed)

    def restart(self) -> None:
        """Begin a new map: the device's clock was reset. Its times are later than all before."""
        self._before_ns = self._newest_ns
        self._start(None)

    def _start(self, seed: ClockSeed | None) -> None:
        self._seed = seed
        self._bins: deque[_Bin] = deque(maxlen=_BINS)
        self._late: list[_Bin] = []  # bins of the newest reads, if all of them are late
        self._lateness = _FIRST_STD_NS  # mean, ns
        self._reads = 0
        self._device0 = 0
        self._host0 = 0
        self._at = 0.0  # start of the current segment of the mapped line, device ns (relative)
        self._lag = 0.0  # lag at `_at`, ns
        self._slope = 0.0  # slope of the lag, with the correction
        self._correction = 0.0  # part of the slope that applies for the next `_SETTLE_NS` only
        self._line: tuple[float, float] | None = None
        self._started = self._seeded = False
        self.step_ns: int = 0

    def map(self, device_ns: NDArray[np.int64], host_ns: int, *, learn: bool = True) -> NDArray[np.int64]:
        """Return the common times of the samples of one read, ns, and update the map with the read.

        Args:
            device_ns: shape (n,), n ≥ 1, ascending device time of the samples.
            host_ns: time at which the read returned; it belongs to the last sample.
            learn: whether the read updates the map; False if the age of its samples is unknown.
        """
        self.step_ns = 0
        if not self._started:
            self._device0, self._host0 = int(device_ns[-1]), host_ns
            self._started = True
            self._begin()
        relative = device_ns - self._device0
        ahead = relative - self._at
        lag = self._lag + self._slope * ahead
        if ahead[-1] > _SETTLE_NS:  # a gap
            lag -= self._correction * np.maximum(ahead - _SETTLE_NS, 0.0)
        times = relative + np.rint(lag).astype(np.int64) + self._host0
        if times[0] <= self._before_ns:
            times = np.maximum(times, self._before_ns + 1 + np.arange(len(times)))
            self._before_ns = int(times[-1])
        self._newest_ns = max(self._newest_ns, int(times[-1]))
        if learn and relative[-1] >= self._at:
            self._learn(float(relative[-1]), float(host_ns - self._host0 - int(relative[-1])))
        return times

    def _begin(self) -> None:
        """Apply the seed, unless it contradicts the first read (the device clock has been reset)."""
        if self._seed is None:
            return
        early = self._host0 - self._seed.host_at(self._device0, self._host0)
        if -_SEED_EARLY_NS < early < _SEED_LATE_NS:
            self._lag, self._slope = float(-max(early, 0)), self._seed.rate
            self._bins.append((-1, 0.0, self._lag, 1))
            self._seeded = True

    def seed(self, wrap_ns: int) -> ClockSeed | None:
        """Return the present state of the clock for the map of the next log, or None before the first read.

        Args:
            wrap_ns: period after which the device clock wraps, ns.
        """
        if not self._started:
            return None
        lag, rate = self._target(self._at)  # the fitted line, to which the mapped time still converges
        return ClockSeed(self._device0 + round(self._at), self._host0 + round(self._at + lag), float(rate), wrap_ns)

    @property
    def std_ns(self) -> float:
        """Standard uncertainty of the time of the newest sample, without the least delay of its path, ns.

        It consists of the uncertainty of the line, the correction that is in progress, and the lateness of the newest
        reads as far as it may be a step of the host's clock. Another thread may map samples meanwhile.
        """
        bins, late = list(self._bins), list(self._late)
        if not bins:
            return _FIRST_STD_NS
        unexplained = 0.0
        if sum(entry[3] for entry in late) >= _LATE_READS:
            unexplained = max(0.0, min(map(_lag_of, late)) - self._target(self._at)[0])
        line = self._line_std_ns(bins)
        if not self._seeded:  # the first reads may all be late; the least of n delays decreases with 1/n
            line = max(line, _FIRST_STD_NS / sum(entry[3] for entry in bins) ** 2)
        return float(line + abs(self._target(self._at)[0] - self._lag) + unexplained)

    def _line_std_ns(self, bins: Collection[_Bin]) -> float:
        """Return the standard uncertainty of the line through some bins at its newest end, ns."""
        reads = sum(entry[3] for entry in bins)
        line = _LEAST_STD_NS + _GAPS * max(self._lateness, _LEAST_JITTER_NS) / reads
        return line if self._line else line + self._tolerance * (self._at - min(bins, key=_lag_of)[1])

    def _learn(self, device: float, lag: float) -> None:
        number = int(device // _BIN_NS)
        if self._bins:
            self._look_for_step(number, device, lag)
        if self._bins and self._bins[-1][0] == number:
            self._bins[-1] = _with_read(self._bins[-1], device, lag)
        else:
            self._fit_closed_bins()
            self._bins.append((number, device, lag, 1))
        target, slope = self._target(device)
        self._reads += 1
        self._lateness += (abs(lag - target) - self._lateness) * max(_MEMORY, 1 / self._reads)
        ahead = device - self._at
        here = self._lag + self._slope * ahead - self._correction * max(ahead - _SETTLE_NS, 0.0)
        self._correction = max(-_MAX_SLEW, min(_MAX_SLEW, (target - here) / _SETTLE_NS))
        self._at, self._lag, self._slope = device, here, slope + self._correction

    def _look_for_step(self, number: int, device: float, lag: float) -> None:
        """Begin the estimate again if the host's clock has stepped.

        A read cannot be early, so one early read is a step back, or the earlier reads were late. Late reads are a step
        forward if none of many was in time and their least lags are equal: a delay would change.
        """
        late = lag - self._target(device)[0]
        if late < -_EARLY_STEP_NS and late < -_EARLY_STDS * self._line_std_ns(self._bins):
            self.step_ns = round(late) if self._reads >= _STEP_READS else 0  # else the first reads were late
            self._begin_again([])
        if late < _LEAST_JITTER_NS + _LATE_SHARE * self._lateness:
            self._late.clear()
            return
        if self._late and self._late[-1][0] == number:
            self._late[-1] = _with_read(self._late[-1], device, lag)
        else:
            self._late.append((number, device, lag, 1))
        del self._late[: -_STEP_BINS - 1]
        closed = self._late[:-1]
        if len(closed) < _STEP_BINS or sum(entry[3] for entry in closed) < _STEP_READS:
            return
        least = [entry[2] for entry in closed]
        step = min(least) - self._target(device)[0]
        if step > _LATE_STEP_NS and max(least) - min(least) < _STEP_SPREAD * step:
            self.step_ns = round(step)
            self._begin_again(closed)
            ahead = device - self._at
            self._lag += max(0.0, self._target(device)[0] - self._lag - self._slope * ahead)

    def _begin_again(self, bins: list[_Bin]) -> None:
        """Discard what was learned before a step, except these bins after it."""
        self._bins.clear()
        self._bins.extend(bins)
        self._late.clear()
        self._line = None
        self._seeded = False

    def _fit_closed_bins(self) -> None:
        """Fit the line each time a bin is complete. A crystal drifts slowly enough for that."""
        if len(self._bins) < 8:
            return
        points = np.array([b[1:3] for b in self._bins])
        offset, slope = lower_line(points[:, 0], points[:, 1])
        if abs(slope) > self._limit:
            slope = float(np.copysign(self._limit, slope))
            offset = float(np.min(points[:, 1] - slope * points[:, 0]))
        self._line = (offset, slope)

    def _target(self, device: float) -> tuple[float, float]:
        if (line := self._line) is None:
            return min(map(_lag_of, list(self._bins)), default=self._lag), 0.0
        offset, slope = line
        return offset + slope * device, slope


def _lag_of(entry: _Bin) -> float:
    return entry[2]


def _with_read(entry: _Bin, device: float, lag: float) -> _Bin:
    """Return a bin with one more read; it keeps the least lag."""
    number, at, least, reads = entry
    return (number, device, lag, reads + 1) if lag < least else (number, at, least, reads + 1)


@dataclass(frozen=True)
class ClockLine:
    """Line host = offset_s + (1 + rate) · device, both in s.

    Attributes:
        offset_s: host time at device time 0, s.
        rate: rate of the host clock relative to the device clock, minus 1.
        rate_std: standard uncertainty of the rate, relative.
        jitter_s: mean distance of the least delayed reads from the line, s.
        shared_std: part of `rate_std` that is common to all records of this clock. It is the part that comes from the
            clock's tolerance and not from the record.
    """

    offset_s: float
    rate: float
    rate_std: float
    jitter_s: float
    shared_std: float

    def host_s(self, device_s: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the common time of device times, s."""
        return self.offset_s + (1 + self.rate) * device_s


def fit_line(
    device_s: NDArray[np.floating], host_s: NDArray[np.floating], tolerance_ppm: float, step_s: float = 0.0
) -> ClockLine:
    """Fit the line of a whole record and combine its rate with the stated tolerance of the clock.

    A read gives the time of its last sample, whose age is between 0 and one sample period. If reads are not synchronous
    with the samples, the least age is close to 0. If reads are synchronous (a whole number of periods apart: a bus that
    is polled every millisecond, a sensor of 4 kHz), the age is constant until the clocks have drifted apart by one
    period. The lags are then a staircase, and a record within one step does not show the drift. The uncertainty of the
    rate is therefore at least half of the error that a step of one period in its middle makes (1.5 periods over the
    length of a record with equal bins), unless the lags follow a straight line over more than one period.

    On a loaded host few reads are in time, and the load may grow or fall in the record. The least lag of each bin then
    lies above the bound of the delay by about the spacing of the least lags of the bin. It is corrected by this spacing
    and weighted with it. The uncertainty contains the change of the rate by the correction.

    Args:
        device_s, host_s: shape (n,), device time of the last sample of each read, and time of its return, s.
        tolerance_ppm: prior standard uncertainty of the rate.
        step_s: sample period, s.
    """
    prior = 1e-6 * tolerance_ppm
    lag = host_s - device_s
    # Long bins contain less delayed reads, short bins give more points. Twenty bins are the compromise.
    width = max(0.25, float(device_s[-1] - device_s[0]) / 20)
    bins = np.floor((device_s - device_s[0]) / width).astype(int)
    groups = np.split(np.arange(len(lag)), _starts(bins))
    best: NDArray[np.intp] = np.array([group[np.argmin(lag[group])] for group in groups], np.intp)
    x: NDArray[np.floating] = device_s[best] - device_s[0]
    y: NDArray[np.floating] = lag[best] - lag[0]
    span = float(x[-1])
    if len(x) < 8:
        offset = float(lag.min())
        return ClockLine(offset, 0.0, prior, float(np.mean(y - float(np.min(y)))), prior)
    constant, slope = lower_line(x, y)
    jitter = float(np.mean(y - constant - slope * x))
    level: NDArray[np.floating] = lag - slope * device_s
    early_s = _edge_spacings([level[group] for group in groups], jitter)
    line = _weighted_line(x, y - early_s, early_s)
    slope = line.slope
    slope_std = np.hypot(line.slope_std, _EDGE_DOUBT * (slope - _weighted_line(x, y, early_s).slope))
    straight = abs(slope) * span > step_s and line.distance < _MAX_STRAIGHT_JITTER * step_s
    own = np.hypot(slope_std, 0.0 if straight else 0.5 * step_s * line.by_step)
    weight = prior**2 / (prior**2 + own**2)
    rate = slope * weight
    offset = float(np.min(y - rate * x)) + float(lag[0]) - rate * float(device_s[0])
    return ClockLine(offset, rate, float(own * np.sqrt(weight)), jitter, float((1 - weight) * prior))


def _edge_spacings(bins: list[NDArray[np.floating]], sparse_s: float) -> NDArray[np.float64]:
    """Return the mean spacing of the least lags of each bin, s: so far is the least one above the bound of the delay.

    Near their bound, n delays of a smooth distribution have equal mean spacings, and the first one lies one spacing
    above the bound. Few reads without delay on a loaded host have a large spacing.

    Args:
        bins: lags of each bin.
        sparse_s: spacing of a bin of one or two reads, whose spacing is not known.
    """
    spacings = np.full(len(bins), sparse_s)
    for i, lag in enumerate(bins):
        count = min(_EDGE_READS, len(lag) - 1)
        if count > 1:
            least = np.partition(lag, count)[: count + 1]
            spacings[i] = float(np.max(least) - np.min(least)) / count
    window = np.ones(_AVERAGED_BINS)  # else a bin whose spacing is small by chance would have a large weight
    return np.convolve(spacings, window, "same") / np.convolve(np.ones(len(bins)), window, "same")


class _WeightedLine(NamedTuple):
    """Line through the least lags of the bins.

    Attributes:
        slope, slope_std: slope and its standard deviation.
        distance: mean height of the bins above the lowest one, s.
        by_step: slope of the line by a step of the lags by 1 s at its middle, 1/s: the largest error for one.
    """

    slope: float
    slope_std: float
    distance: float
    by_step: float


def _weighted_line(x: NDArray[np.floating], y: NDArray[np.floating], spacing: NDArray[np.floating]) -> _WeightedLine:
    """Fit the lower edge of lags whose bins are late by different amounts, as on a host whose load changes.

    A bin has the uncertainty of `_EDGE_STDS` spacings, and at least its own height above the line: what delays all of
    its reads leaves no spacing. The first line is the lower edge of all.
    """
    constant, slope = lower_line(x, y)
    std = np.zeros(len(x))
    for _ in range(_LINE_ROUNDS):
        above = np.abs(y - constant - slope * x)
        std = np.hypot(np.hypot(_EDGE_STDS * spacing, above), _LEAST_SPACING_S)
        weight = std**-2.0
        middle = float(np.average(x, weights=weight))
        slope = float(np.average((x - middle) * y, weights=weight) / np.average((x - middle) ** 2, weights=weight))
        constant = float(np.average(y, weights=weight)) - slope * middle
    weight = std**-2.0
    middle = float(np.average(x, weights=weight))
    spread = np.hypot(_EDGE_STDS * spacing, _LEAST_SPACING_S)
    above = y - slope * x
    distance = float(np.average(above - np.min(above), weights=spread**-2.0))
    moment = float(np.sum(weight * (x - middle) ** 2))
    by_step = 0.5 * float(np.sum(weight * np.abs(x - middle))) / moment
    return _WeightedLine(slope, moment**-0.5, distance, by_step)


def _starts(bins: NDArray[np.int_]) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(bins)) + 1


def steps_from(before: int, values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the differences of consecutive values, the first relative to `before`; shape (n,).

    It is a faster `np.diff(values, prepend=before)`.
    """
    steps = np.empty_like(values)
    steps[0] = values[0] - before
    np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps


class Unwrap:
    """Converts a counter that wraps at `size` to a continuous integer."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._last: int | None = None

    def feed(self, values: NDArray[np.integer]) -> NDArray[np.int64]:
        """Return the unwrapped values, shape (n,), each the nearest continuation of the previous one."""
        raw = values.astype(np.int64)
        if len(raw) == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = steps_from(first % self._size, raw)
        steps = (steps + self._size // 2) % self._size - self._size // 2
        result = first + np.cumsum(steps)
        self._last = int(result[-1])
        return result
