"""Losses that the packets' numbers cannot count, estimated from the host's time.

Packets are numbered modulo 4, so a loss is known modulo 4. The lag of a read is the time by which its last result came
later than the number of the result times the sampling period. If 4 k results are missing, all later lags are 4 k
periods larger. A lag consists of a minimum and of the host's own lateness, which is temporary. The estimate therefore
uses the smallest lag of each interval of 0.25 s, and whether it stays increased.

The sensitivity depends on how regularly the host reads. The smallest lags of undisturbed intervals scatter. An increase
counts as loss if it exceeds `guard_ns`: six times that scatter, at least 2 ms and three periods. Losses of multiples of
4 below the guard are not detected, and the count of a larger loss may be wrong by as much. On a busy host the guard is
large; losses of a third of it are then found after 2 s, by the least lag of eight intervals. No loss is detected in the
first 1.5 s, or while results arrive at another rate than that of the rig file.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import fmean, median

from daq.drivers.riftek.wire import NUMBERS

_INTERVAL_NS, _INTERVAL_PERIODS = 250_000_000, 16
_MAX_INTERVALS = 24
_MIN_INTERVALS = 4  # intervals before a loss can be detected
_RISEN_INTERVALS = 3  # consecutive intervals with an increased lag that show a loss
_MIN_READS = 4  # reads in an interval that is used
_MIN_GUARD_NS = 2_000_000
_GUARD_SCATTERS = 6.0
_LONG_GUARD_SCATTERS = 2.0  # eight standard deviations of the difference of least lags of eight intervals
_MAX_DRIFT = 1e-3  # relative deviation of the rate that a clock explains; a larger one is another rate
_MIN_FAR_NS = 30_000_000


class ReadLags:
    """The lags of one sensor's reads.

    Args:
        period_ns: sampling period, ns.

    Attributes:
        since_s: longest time since the loss that was found last, s.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.since_s: float = 0.0
        self._interval_ns = max(_INTERVAL_NS, _INTERVAL_PERIODS * period_ns)
        self._done: deque[tuple[int, float]] = deque(maxlen=_MAX_INTERVALS)  # index of an interval, its least lag, ns
        self._now: tuple[int, float, int] | None = None  # index, least lag and reads of the present interval
        self._origin_ns: int | None = None  # host time at which the lag is 0
        self._slope = self._scatter_ns = 0.0
        self._base: tuple[int, float] | None = None  # index of an interval and the lag expected there, ns

    @property
    def guard_ns(self) -> float:
        """Smallest increase of the least lag that counts as a loss, ns."""
        return max(_MIN_GUARD_NS, 3.0 * self._period_ns, _GUARD_SCATTERS * self._scatter_ns)

    @property
    def far_ns(self) -> float:
        """Smallest lateness of a single read that is examined without waiting for further intervals, ns."""
        return max(_MIN_FAR_NS, 8.0 * self._period_ns, 3.0 * self.guard_ns)

    @property
    def uncertainty(self) -> int:
        """Uncertainty of a count by the host's time, results: a multiple of 4."""
        return NUMBERS * round(self.guard_ns / (NUMBERS * self._period_ns) + 0.5)

    def excess_ns(self, number: int, host_ns: int) -> float | None:
        """Return by how much a read is later than expected, ns; None if no expectation exists yet.

        Args:
            number: number of the read's last result, including lost ones.
            host_ns: host time at which the read returned, ns since 1970.
        """
        if self._base is None or self._origin_ns is None:
            return None
        interval, lag = self._base
        expected = lag + self._slope * (host_ns // self._interval_ns - interval)
        return self._lag(number, host_ns) - expected

    def missing(self, excess_ns: float) -> int:
        """Return the number of missing results for an excess, a multiple of 4; 0 below the guard."""
        if excess_ns < self.guard_ns:
            return 0
        return NUMBERS * round(excess_ns / (NUMBERS * self._period_ns))

    def turn(self, host_ns: int) -> int:
        """Close the present interval if its time is over.

        Returns:
            Number of results newly found missing: a multiple of 4, usually 0.
        """
        if self._now is None or host_ns // self._interval_ns <= self._now[0]:
            return 0
        number, lag, reads = self._now
        self._now = None
        if reads < _MIN_READS:
            return 0
        self._done.append((number, lag))
        lost, count = self._rise(), _RISEN_INTERVALS
        if not lost:
            lost, count = self._long_rise(), _MAX_INTERVALS // 3
        if lost:
            self.since_s = (count + 2) * self._interval_ns * 1e-9
            risen = [self._done.pop() for _ in range(count)]
            self._done += [(number, lag - lost * self._period_ns) for number, lag in reversed(risen)]
        self._expect()
        return lost

    def look(self, number: int, host_ns: int) -> None:
        """Take the end of a read; arguments as for `excess_ns`."""
        if self._origin_ns is None:
            self._origin_ns = host_ns - number * self._period_ns
        interval, lag = host_ns // self._interval_ns, self._lag(number, host_ns)
        if self._now is None:
            self._now = interval, lag, 1
        else:
            self._now = self._now[0], min(self._now[1], lag), self._now[2] + 1

    def _lag(self, number: int, host_ns: int) -> float:
        assert self._origin_ns is not None
        return float(host_ns - number * self._period_ns - self._origin_ns)

    def _rise(self) -> int:
        """Return the missing results if all newest intervals lie above the extrapolation of the older ones, else 0."""
        if self._base is None or len(self._done) < _MIN_INTERVALS:
            return 0
        interval, lag = self._base
        above = min(
            found - lag - self._slope * (number - interval) for number, found in list(self._done)[-_RISEN_INTERVALS:]
        )
        return self.missing(above)

    def _long_rise(self) -> int:
        """Return the missing results by the least lags of the newest, the middle and the oldest third, else 0.

        On a busy host the least lag of an interval scatters; that of eight intervals scatters by an eighth of it. The
        drift of the clock is that from the oldest to the middle third.
        """
        if len(self._done) < _MAX_INTERVALS:
            return 0
        lags, third = [lag for _, lag in self._done], _MAX_INTERVALS // 3
        oldest, middle, newest = min(lags[:third]), min(lags[third : 2 * third]), min(lags[2 * third :])
        rise = newest - middle - abs(middle - oldest)
        guard = max(_MIN_GUARD_NS, 3.0 * self._period_ns, _LONG_GUARD_SCATTERS * self._scatter_ns)
        return NUMBERS * round(rise / (NUMBERS * self._period_ns)) if rise >= guard else 0

    def _expect(self) -> None:
        """Update the expected lag from all but the newest intervals, whose lags may have increased already."""
        known = list(self._done)[: 1 - _RISEN_INTERVALS]
        if len(known) < _MIN_INTERVALS - 1:
            return
        slopes = [(b - a) / (j - i) for (i, a), (j, b) in pairwise(known)]
        self._slope = median(slopes)
        last = known[-1][0]
        level = [lag + self._slope * (last - number) for number, lag in known]
        self._scatter_ns = fmean(abs(a - b) for a, b in pairwise(level))
        steady = abs(self._slope) <= _MAX_DRIFT * self._interval_ns
        self._base = (last, median(level[-8:])) if steady else None
