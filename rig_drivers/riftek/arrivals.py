"""Losses that the packets' numbers cannot count, and another rate of the results, by the host's time.

Packets are numbered modulo 4, so a loss is known modulo 4, and a cycle of the numbers is shorter than the time between
two reads. If 4 k results are missing, all later reads are later by 4 k periods than they are due
(`daq.numbered.due_line`). A host's own lateness is temporary. The estimate therefore uses the least lateness of each
interval of 0.25 s, and whether it stays increased.

The sensitivity depends on how regularly the host reads. An increase counts as loss if it exceeds `guard_ns`: six times
the mean least lateness of undisturbed intervals, at least 2 ms and three periods. Losses of multiples of 4 below the
guard are not detected, and the count of a larger loss may be wrong by as much. Losses of a third of the guard are found
after 2 s, by the least lateness of eight intervals. No loss is detected in the first second, or while results
arrive at another rate than that of the rig file.
"""

from __future__ import annotations

from collections import deque
from statistics import fmean

from daq.numbered.due_line import RATE_ERROR, DueLine
from rig_drivers.riftek import wire

_INTERVAL_NS, _INTERVAL_PERIODS = 250_000_000, 16
_INTERVALS, _FEWEST_INTERVALS = 24, 4
_RISES = ((3, 6.0), (8, 2.0))
"""Intervals with an increased lateness that show a loss, and its ratio to the mean of those before: for a lateness
without memory all of them exceed it once in 10⁷ intervals."""
_LEAST_READS = 4  # of an interval that is used
_LEAST_GUARD_NS, _LEAST_FAR_NS = 2_000_000, 30_000_000
_OTHER_RATE = 0.25
_LONGEST_PAUSE_NS = 500_000_000  # between reads; after a longer one the host reads what has accumulated
_RATE_NS = 3_000_000_000  # for which another rate lasts: the due line then has no results of the earlier one


class Arrivals:
    """The reads of one sensor's results.

    Args:
        period_ns: sampling period, ns.

    Attributes:
        since_s: longest time since the loss that was found last, s.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.since_s: float = 0.0
        self._interval_ns = max(_INTERVAL_NS, _INTERVAL_PERIODS * period_ns)
        self._due = DueLine(_LEAST_GUARD_NS)
        self._least: deque[float] = deque(maxlen=_INTERVALS)  # least lateness of intervals, ns
        self._now: tuple[int, float, int] | None = None  # index, least lateness and reads of the present interval

    @property
    def guard_ns(self) -> float:
        """Smallest increase of the least lateness that counts as a loss, ns."""
        return self._guard_ns(*_RISES[0])

    @property
    def far_ns(self) -> float:
        """Smallest lateness of a single read that is examined without waiting for further intervals, ns."""
        return max(_LEAST_FAR_NS, 8.0 * self._period_ns, 3.0 * self.guard_ns)

    @property
    def uncertainty(self) -> int:
        """Uncertainty of a count by the host's time, results: a multiple of 4."""
        return wire.NUMBERS * round(self.guard_ns / (wire.NUMBERS * self._period_ns) + 0.5)

    def late_ns(self, number: int, host_ns: int) -> float | None:
        """Return by how much a read is later than it is due, ns; None as long as this is not known.

        Args:
            number: number of the read's last result, including lost ones.
            host_ns: host time at which the read returned, ns since 1970.
        """
        if len(self._least) < _FEWEST_INTERVALS or abs(self._due.pace - 1.0) > RATE_ERROR:
            return None
        return self._due.late_ns(number * self._period_ns, host_ns)

    def missing(self, late_ns: float) -> int:
        """Return the number of missing results for a lateness, a multiple of 4; 0 below the guard."""
        return self._cycles(late_ns) if late_ns >= self.guard_ns else 0

    def turn(self, host_ns: int) -> int:
        """Close the present interval if its time is over.

        Returns:
            Number of results newly found missing: a multiple of 4, usually 0.
        """
        if self._now is None or host_ns // self._interval_ns <= self._now[0]:
            return 0
        _, least_ns, reads = self._now
        self._now = None
        if reads < _LEAST_READS:
            return 0
        self._least.append(least_ns)
        for count, ratio in _RISES:
            newest = list(self._least)[-count:]
            if len(self._least) < count + _FEWEST_INTERVALS or abs(self._due.pace - 1.0) > RATE_ERROR:
                continue
            usual_ns = fmean(list(self._least)[:-count]) / count  # least one of so many without a loss
            if min(newest) >= self._guard_ns(count, ratio) and (lost := self._cycles(min(newest) - usual_ns)):
                self.since_s = (count + 2) * self._interval_ns * 1e-9
                for _ in newest:
                    self._least.pop()
                self._least += [each - lost * self._period_ns for each in newest]
                return lost
        return 0

    def look(self, number: int, host_ns: int) -> None:
        """Take the end of a read; arguments as for `late_ns`."""
        self._due.take(number * self._period_ns, host_ns)
        late_ns = self._due.late_ns(number * self._period_ns, host_ns)
        index, least_ns, reads = self._now or (host_ns // self._interval_ns, late_ns, 0)
        self._now = index, min(least_ns, late_ns), reads + 1

    def _guard_ns(self, newest: int, ratio: float) -> float:
        before = list(self._least)[:-newest] or [0.0]
        return max(_LEAST_GUARD_NS, 3.0 * self._period_ns, ratio * fmean(before))

    def _cycles(self, late_ns: float) -> int:
        return wire.NUMBERS * round(late_ns / (wire.NUMBERS * self._period_ns))


class ResultRate:
    """Finds that a sensor has lost its settings: its results arrive at another rate than it was set to.

    Its packets have no time and are numbered modulo 4. Results at another rate are therefore taken for losses, or for
    results that arrive early, and their times are wrong.

    Args:
        period_ns: sampling period to which the sensor was set, ns.

    Attributes:
        sign: what shows that the sensor is set otherwise, a clause; empty without such a sign. The request that starts
            the stream resets it.
    """

    def __init__(self, period_ns: int) -> None:
        self.sign: str = ""
        self._period_ns = period_ns
        self._begin()

    def _begin(self) -> None:
        self._due, self._results, self._right_ns = DueLine(_LEAST_GUARD_NS), 0, 0

    def sent(self, data: bytes) -> None:
        """Take bytes sent to the sensor."""
        if wire.START in wire.codes_of(data):
            self.sign = ""
            self._begin()

    def received(self, results: int, host_ns: int, *, damaged: bool) -> None:
        """Take the results of one read.

        Args:
            results: their number.
            host_ns: host time of the read, ns since 1970.
            damaged: whether bytes were skipped; the number of results is then unknown.
        """
        if damaged or not self._due.begun or host_ns - self._due.heard_ns > _LONGEST_PAUSE_NS:
            self._begin()
            self._right_ns = host_ns
        self._results += results
        self._due.take(self._results * self._period_ns, host_ns)
        ratio = 1.0 / self._due.pace if self._due.pace > 0 else float("inf")
        if abs(ratio - 1.0) <= _OTHER_RATE:
            self._right_ns = host_ns
        elif host_ns - self._right_ns > _RATE_NS and not self.sign:
            self.sign = (
                f"its results arrive {ratio * 1e9 / self._period_ns:.0f} times a second and it was set to "
                f"{1e9 / self._period_ns:.0f}, so it may have lost power and its settings, and its times and losses "
                "since then are wrong"
            )
