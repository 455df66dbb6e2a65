"""Device clocks onto the common clock.

A sample made at device time d reaches the host at h = offset + rate·d + delay with delay ≥ some floor. The least
delayed samples lie on the lower edge of h against d, so the straight line under all points that runs closest to them
(the edge of the lower convex hull above the mean time) recovers offset and rate, up to the constant floor.

`ClockMap` follows that line causally while recording; its output is continuous and strictly increasing. Its rules have
a number that a log keeps, so that old logs decode to the times that they hold.
`fit_line` uses a whole log at once and says how well it knows the rate.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from daq.errors import DeviceError

CLOCK_RULES = "clock_rules"
"""Key of a device's identity, and of a log's facts: by which rules its bytes are decoded. See `clock_rules`."""
FIRST_RULES, NEWEST_RULES = 1, 3
_IN_ORDER_RULES = 3
CLOCK_SEED = "clock_seed"
"""Key of a device's identity: how its clock stood when the log began. See `ClockSeed`."""
_SEED_EARLY_NS, _SEED_LATE_NS = 5_000_000, 1_000_000_000
_BIN_NS = 250_000_000
_BINS = 120
_SLEW = 0.5  # largest relative correction of the mapped clock's rate; below 1, so that time never runs backwards
_STRAIGHT = 0.15  # mean distance of least lags from their line, in the samples' periods; a staircase's is 0.25 and more
_SETTLE_NS = 300_000_000  # time constant of a correction: a first read that came late is soon made good


def lower_line(device: NDArray[np.floating], lag: NDArray[np.floating]) -> tuple[float, float]:
    """The line under all points with the least sum of distances.

    Args:
        device, lag: shape (n,), device time ascending, and host time minus device time, same unit.
    Returns:
        Lag at device time 0 and slope.
    """
    if len(device) == 1:
        return float(lag[0]), 0.0
    middle = float(np.mean(device))
    a, b = _edge(np.ascontiguousarray(device, np.float64), np.ascontiguousarray(lag, np.float64), middle)
    slope = float((lag[b] - lag[a]) / (device[b] - device[a]))
    return float(lag[a] - slope * device[a]), slope


@njit(cache=True, nogil=True, error_model="numpy")
def _edge(
    device: NDArray[np.float64], lag: NDArray[np.float64], middle: float
) -> tuple[int, int]:  # pragma: no cover - compiled
    """The two points of the lower convex hull, of two points or more, between which its edge passes `middle`."""
    hull, size = np.empty(len(device), np.int64), 0
    for i in range(len(device)):
        while size > 1:
            a, b = hull[size - 2], hull[size - 1]
            turn = (device[b] - device[a]) * (lag[i] - lag[a]) - (lag[b] - lag[a]) * (device[i] - device[a])
            if turn > 0:
                break
            size -= 1
        hull[size] = i
        size += 1
    k = 0
    while k < size - 2 and device[hull[k + 1]] < middle:
        k += 1
    return hull[k], hull[k + 1]


def compile_line() -> None:
    """Load what is compiled, or compile it, before any read waits for it."""
    lower_line(np.arange(3.0), np.zeros(3))


def clock_rules(identity: Mapping[str, Any]) -> int:
    """By which rules a pipeline decodes, its clock map first of all.

    From 3 on encoder blocks of a node wait at a hole for blocks that are sent again; for 1 and 2 see `ClockMap`.

    Args:
        identity: as a pipeline is given it: of a log that is decoded again it holds the log's rules.
    """
    return int(identity.get(CLOCK_RULES, NEWEST_RULES))


@dataclass(frozen=True)
class ClockSeed:
    """How a device's clock stood against the common one, as known before a log began.

    Attributes:
        device_ns, host_ns: an instant by both clocks.
        rate: common seconds for each of the device's, less 1.
        wrap_ns: after which the device's clock begins again.
    """

    device_ns: int
    host_ns: int
    rate: float
    wrap_ns: int

    @classmethod
    def of(cls, identity: Mapping[str, Any]) -> ClockSeed | None:
        """The one that a pipeline is given with its device's identity; None where there is none.

        Raises:
            DeviceError: no clock can stand so.
        """
        told = identity.get(CLOCK_SEED)
        if told is None:
            return None
        try:
            seed = cls(**told)
            whole = all(type(ns) is int and abs(ns) < 2**63 for ns in (seed.device_ns, seed.host_ns, seed.wrap_ns))
            if whole and seed.wrap_ns > 0 and type(seed.rate) is float and abs(seed.rate) < _SLEW:
                return seed
        except TypeError:
            pass
        raise DeviceError(f"clocks.json: expected device_ns, host_ns, rate and wrap_ns of a clock, got {told!r:.120}")

    def host_at(self, device_ns: int, near_ns: int) -> int:
        """Common time of an instant by the device's clock: of all that a wrap apart, the one nearest to `near_ns`."""
        ahead = device_ns - self.device_ns
        at_ns = self.host_ns + ahead + round(self.rate * ahead)
        turn_ns = self.wrap_ns + round(self.rate * self.wrap_ns)
        return at_ns + turn_ns * round((near_ns - at_ns) / turn_ns)


class ClockMap:
    """Causal map of one device's clock (ns, unwrapped) to the common clock (ns since 1970).

    Args:
        tolerance_ppm: standard uncertainty of the device's rate; the estimated rate is kept within five of them.
        rules: 1: a correction goes on until the next read, however late that comes; from 2 on: only until it is made
            good; from 3 on nothing is learnt of samples older than those that came before.
        seed: how the clock stood before; without it the first read counts as one that was not delayed.
    """

    def __init__(self, tolerance_ppm: float, rules: int = NEWEST_RULES, seed: ClockSeed | None = None) -> None:
        self._seed = seed
        self._limit = 5e-6 * tolerance_ppm
        self._correct_ns = np.inf if rules == FIRST_RULES else float(_SETTLE_NS)
        self._in_order = rules >= _IN_ORDER_RULES
        self._bins: deque[tuple[int, float, float]] = deque(maxlen=_BINS)  # bin, device ns, lag ns (relative)
        self._device0 = 0
        self._host0 = 0
        self._at = 0.0  # mapped line: device ns (relative) …
        self._lag = 0.0  # … its lag there, …
        self._slope = 0.0  # … its slope …
        self._correction = 0.0  # … and what comes on top of it for the next `_correct_ns`
        self._line: tuple[float, float] | None = None
        self._started = False

    def map(self, device_ns: NDArray[np.int64], host_ns: int) -> NDArray[np.int64]:
        """Times of the samples of one read, and learn from it.

        Args:
            device_ns: shape (n,), n ≥ 1, device time of the samples, ascending.
            host_ns: when the read returned; belongs to the last sample.
        """
        if not self._started:
            self._device0, self._host0 = int(device_ns[-1]), host_ns
            self._started = True
            self._begin()
        relative = device_ns - self._device0
        ahead = relative - self._at
        lag = self._lag + self._slope * ahead
        if ahead[-1] > self._correct_ns:  # a gap
            lag -= self._correction * np.maximum(ahead - self._correct_ns, 0.0)
        times = relative + np.rint(lag).astype(np.int64) + self._host0
        if relative[-1] >= self._at or not self._in_order:
            self._learn(float(relative[-1]), float(host_ns - self._host0 - int(relative[-1])))
        return times

    def _begin(self) -> None:
        """Take over what was known of the clock, unless it is another one by now."""
        if self._seed is None:
            return
        early = self._host0 - self._seed.host_at(self._device0, self._host0)
        if -_SEED_EARLY_NS < early < _SEED_LATE_NS:
            self._lag, self._slope = float(-max(early, 0)), self._seed.rate
            self._bins.append((-1, 0.0, self._lag))

    def seed(self, wrap_ns: int) -> ClockSeed | None:
        """How the clock stands now, for the map of the next log; None before the first read.

        Args:
            wrap_ns: after which the device's clock begins again.
        """
        if not self._started:
            return None
        lag, rate = self._target(self._at)  # where the mapped time is still on its way to
        return ClockSeed(self._device0 + round(self._at), self._host0 + round(self._at + lag), float(rate), wrap_ns)

    def _learn(self, device: float, lag: float) -> None:
        number = int(device // _BIN_NS)
        if self._bins and self._bins[-1][0] == number:
            if lag < self._bins[-1][2]:
                self._bins[-1] = (number, device, lag)
        else:
            self._fit_closed_bins()
            self._bins.append((number, device, lag))
        target, slope = self._target(device)
        ahead = device - self._at
        here = self._lag + self._slope * ahead - self._correction * max(ahead - self._correct_ns, 0.0)
        self._correction = max(-_SLEW, min(_SLEW, (target - here) / _SETTLE_NS))
        self._at, self._lag, self._slope = device, here, slope + self._correction

    def _fit_closed_bins(self) -> None:
        """A new line each time a bin is complete: often enough for a crystal, and cheap."""
        if len(self._bins) < 8:
            return
        points = np.array([b[1:] for b in self._bins])
        offset, slope = lower_line(points[:, 0], points[:, 1])
        if abs(slope) > self._limit:
            slope = float(np.copysign(self._limit, slope))
            offset = float(np.min(points[:, 1] - slope * points[:, 0]))
        self._line = (offset, slope)

    def _target(self, device: float) -> tuple[float, float]:
        if self._line is None:
            return min(b[2] for b in self._bins), 0.0
        offset, slope = self._line
        return offset + slope * device, slope


@dataclass(frozen=True)
class ClockLine:
    """host = offset_s + (1 + rate) · device, both in s.

    Attributes:
        rate_std: standard uncertainty of the rate, relative.
        jitter_s: mean distance of the least delayed reads from the line.
        shared_std: what of rate_std every record of this clock has alike: as far as a rate was not read from the record
            but taken from the clock's tolerance, all records are off by the same.
    """

    offset_s: float
    rate: float
    rate_std: float
    jitter_s: float
    shared_std: float

    def host_s(self, device_s: NDArray[np.floating]) -> NDArray[np.floating]:
        """Common-clock time of device times."""
        return self.offset_s + (1 + self.rate) * device_s


def fit_line(
    device_s: NDArray[np.floating], host_s: NDArray[np.floating], tolerance_ppm: float, step_s: float = 0.0
) -> ClockLine:
    """The line of a whole record, its rate combined with the clock's stated tolerance.

    A read tells the time of its last sample, which is up to a sample's period old. Where samples are fetched at random,
    some have just been made. Where they are fetched in step (a whole number of periods apart: a bus that is polled
    every millisecond, a sensor of 4 kHz) that age stays the same until the clocks have drifted apart by a period: the
    lags are a staircase, and a record within one step of it does not show the drift at all. So a rate is not known
    better than to a period in the record's length, unless the lags follow a line over more than a period without
    stairs.

    Args:
        device_s, host_s: shape (n,), device time of the last sample of each read and when the read returned.
        tolerance_ppm: prior standard uncertainty of the rate.
        step_s: period of the samples.
    """
    prior = 1e-6 * tolerance_ppm
    lag = host_s - device_s
    # Long bins find less delayed reads, short ones leave more points: twenty balance the two.
    width = max(0.25, float(device_s[-1] - device_s[0]) / 20)
    bins = np.floor((device_s - device_s[0]) / width).astype(int)
    best = np.array([group[np.argmin(lag[group])] for group in np.split(np.arange(len(lag)), _starts(bins))])
    x, y = device_s[best] - device_s[0], lag[best] - lag[0]
    span = float(x[-1])
    if len(x) < 8 or span < 1.5:
        offset = float(lag.min())
        return ClockLine(offset, 0.0, prior, float(np.mean(y - y.min())), prior)
    constant, slope = lower_line(x, y)
    jitter = float(np.mean(y - constant - slope * x))
    straight = abs(slope) * span > step_s and jitter < _STRAIGHT * step_s
    unseen = 0.0 if straight else step_s
    own = np.hypot(max(jitter, 1e-6) * np.sqrt(12.0 / len(x)), unseen / np.sqrt(3.0)) / span
    weight = prior**2 / (prior**2 + own**2)
    rate = slope * weight
    offset = float(np.min(y - rate * x)) + float(lag[0]) - rate * float(device_s[0])
    return ClockLine(offset, rate, float(own * np.sqrt(weight)), jitter, float((1 - weight) * prior))


def _starts(bins: NDArray[np.int_]) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(bins)) + 1


def steps_from(before: int, values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Differences of consecutive values, the first from `before`; shape (n,): a quick `np.diff` with prepend."""
    steps = np.empty_like(values)
    steps[0] = values[0] - before
    np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps


class Unwrap:
    """Continues a counter that wraps at `size` into an ever growing integer."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._last: int | None = None

    def feed(self, values: NDArray[np.integer]) -> NDArray[np.int64]:
        """Unwrapped values, each the nearest continuation of the one before; shape (n,)."""
        raw = values.astype(np.int64)
        if len(raw) == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = steps_from(first % self._size, raw)
        steps = (steps + self._size // 2) % self._size - self._size // 2
        result = first + np.cumsum(steps)
        self._last = int(result[-1])
        return result
