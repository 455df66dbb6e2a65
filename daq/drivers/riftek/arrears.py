# pyright: strict
"""What the host's time says of results that the packets' numbers cannot count.

Packets are numbered modulo 4, so a loss is known modulo 4. By how much the last result of a read came later than its
number times the sampling period, its lag, says the rest: where 4 k results are missing, all lags from there on are
4 k periods larger. A lag has a floor, under which no read comes, and above it the host's own lateness, which passes.
So what counts is the least lag of a stretch of a quarter of a second, and whether it stays up.

How well that tells depends on how evenly the host reads. The floor of undisturbed stretches scatters; a rise counts as
loss where it is above `guard_ns`: six times that scatter, never less than 2 ms or three periods. What is lost in
multiples of 4 below the guard goes unseen, and a count of a larger loss may be wrong by as much. Nothing can be told
in the first second and a half, and nothing while results come at another rate than the rig file's.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import fmean, median

from daq.drivers.riftek.wire import NUMBERS

_STRETCH_NS, _STRETCH_PERIODS = 250_000_000, 16
_STRETCHES = 24
_NEEDED = 4  # stretches before anything is told
_RISEN = 3  # stretches in a row that lie higher than those before
_READS = 4  # in a stretch that tells anything
_LEAST_GUARD_NS = 2_000_000
_SCATTERS = 6.0
_MOST_DRIFT = 1e-3  # of the rate: more is another rate, not a clock
_FAR_NS = 30_000_000


class Arrears:
    """The lags of one sensor's reads.

    Args:
        period_ns: from one result to the next.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._stretch_ns = max(_STRETCH_NS, _STRETCH_PERIODS * period_ns)
        self._done: deque[tuple[int, float]] = deque(maxlen=_STRETCHES)  # number of a stretch, its least lag, ns
        self._now: tuple[int, float, int] | None = None  # number, least lag and reads of the stretch under way
        self._origin_ns: int | None = None  # lags count from the first one's
        self._slope = self._scatter_ns = 0.0
        self._base: tuple[int, float] | None = None  # a stretch's number and the lag expected there

    @property
    def guard_ns(self) -> float:
        """How large a rise of the least lag has to be, to be a loss."""
        return max(_LEAST_GUARD_NS, 3.0 * self._period_ns, _SCATTERS * self._scatter_ns)

    @property
    def far_ns(self) -> float:
        """By how much a read has to be late to be looked at by itself."""
        return max(_FAR_NS, 8.0 * self._period_ns, 3.0 * self.guard_ns)

    @property
    def uncertainty(self) -> int:
        """By how many results a count by the host's time may be wrong: a multiple of 4."""
        return NUMBERS * round(self.guard_ns / (NUMBERS * self._period_ns) + 0.5)

    def excess_ns(self, number: int, host_ns: int) -> float | None:
        """By how much a read is later than expected; None where nothing can be told.

        Args:
            number: of the read's last result, lost ones counted.
            host_ns: when the read returned.
        """
        if self._base is None or self._origin_ns is None:
            return None
        stretch, lag = self._base
        expected = lag + self._slope * (host_ns // self._stretch_ns - stretch)
        return self._lag(number, host_ns) - expected

    def missing(self, excess_ns: float) -> int:
        """How many results an excess stands for, a multiple of 4; 0 below the guard."""
        if excess_ns < self.guard_ns:
            return 0
        return NUMBERS * round(excess_ns / (NUMBERS * self._period_ns))

    def turn(self, host_ns: int) -> int:
        """Close the stretch under way when its time is over.

        Returns:
            How many results are found missing since before it: a multiple of 4, mostly 0.
        """
        if self._now is None or host_ns // self._stretch_ns <= self._now[0]:
            return 0
        number, lag, reads = self._now
        self._now = None
        if reads < _READS:
            return 0
        self._done.append((number, lag))
        lost = self._rise()
        if lost:
            risen = [self._done.pop() for _ in range(_RISEN)]
            self._done += [(number, lag - lost * self._period_ns) for number, lag in reversed(risen)]
        self._expect()
        return lost

    def look(self, number: int, host_ns: int) -> None:
        """Take the end of a read; see `excess_ns`."""
        if self._origin_ns is None:
            self._origin_ns = host_ns - number * self._period_ns
        stretch, lag = host_ns // self._stretch_ns, self._lag(number, host_ns)
        if self._now is None:
            self._now = stretch, lag, 1
        else:
            self._now = self._now[0], min(self._now[1], lag), self._now[2] + 1

    def _lag(self, number: int, host_ns: int) -> float:
        assert self._origin_ns is not None
        return float(host_ns - number * self._period_ns - self._origin_ns)

    def _rise(self) -> int:
        """Results missing by the newest stretches: all must lie above what those before them lead to."""
        if self._base is None or len(self._done) < _NEEDED:
            return 0
        stretch, lag = self._base
        above = min(found - lag - self._slope * (number - stretch) for number, found in list(self._done)[-_RISEN:])
        return self.missing(above)

    def _expect(self) -> None:
        """What the next stretches are measured by: not by the newest ones, which may have risen already."""
        known = list(self._done)[: 1 - _RISEN]
        if len(known) < _NEEDED - 1:
            return
        slopes = [(b - a) / (j - i) for (i, a), (j, b) in pairwise(known)]
        self._slope = median(slopes)
        last = known[-1][0]
        level = [lag + self._slope * (last - number) for number, lag in known]
        self._scatter_ns = fmean(abs(a - b) for a, b in pairwise(level))
        steady = abs(self._slope) <= _MOST_DRIFT * self._stretch_ns
        self._base = (last, median(level[-8:])) if steady else None
