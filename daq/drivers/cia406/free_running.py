"""Samples without SYNC: each encoder sends by its own timer, at instants that differ between the encoders.

A report has neither a number nor a time. Its time is that of the encoder's timer, which is followed by the earliest
arrivals; missing reports are a pause of whole periods. A sample is a report of encoder A with the newest position of B,
which is up to one period older.
"""

from __future__ import annotations

from daq.drivers.cia406.reports import Instant

_DRIFT = 1e-3  # largest rate error of an encoder's timer that is followed
_TIMELY = 0.1  # of a period, by which a report after a pause of whole periods may come too early
_WAIT_NS = 60_000_000  # time for which all reports must come late before the first of them has missing ones before it

Values = tuple[int, ...]


class OwnTimer:
    """Times of one encoder's reports.

    Reports that come late by a whole period or more wait. If a report in time follows, they were delayed on their way;
    otherwise there are missing ones before them.

    Args:
        period_ns: period of the encoder's timer, ns.
        delay_ns: time from the sampling to the host's read, ns.

    Attributes:
        missing: number of missing reports.
    """

    def __init__(self, period_ns: int, delay_ns: int) -> None:
        self.missing: int = 0
        self._period_ns, self._delay_ns = period_ns, delay_ns
        self._number = -1
        self._base_ns = 0.0  # time of report 0, by the earliest arrivals
        self._waiting: list[tuple[Values, int, int]] = []  # values, host time, whole periods by which it is late

    def feed(self, values: Values, host_ns: int) -> list[tuple[Instant, Values]]:
        """Take a report; return the reports whose times are known now, with their values."""
        if self._number < 0:
            self._base_ns = float(host_ns)
            return [self._take(values, host_ns, 0)]
        due_ns = self._base_ns + (self._number + 1 + len(self._waiting)) * self._period_ns
        late = int((host_ns - due_ns) / self._period_ns + _TIMELY)
        if late <= 0:
            return [*self._release(0), self._take(values, host_ns, 0)]
        self._waiting.append((values, host_ns, late))
        return self.end() if host_ns - self._waiting[0][1] >= _WAIT_NS else []

    def end(self) -> list[tuple[Instant, Values]]:
        """Return the reports that wait: no report in time follows them."""
        return self._release(min((late for _, _, late in self._waiting), default=0))

    def _release(self, missing: int) -> list[tuple[Instant, Values]]:
        waiting, self._waiting = self._waiting, []
        return [
            self._take(values, host_ns, 0 if place else missing) for place, (values, host_ns, _) in enumerate(waiting)
        ]

    def _take(self, values: Values, host_ns: int, missing: int) -> tuple[Instant, Values]:
        self.missing += missing
        self._number += 1 + missing
        own_ns = self._number * self._period_ns
        drifted_ns = self._base_ns + _DRIFT * (1 + missing) * self._period_ns
        self._base_ns = min(drifted_ns, float(host_ns - own_ns))
        return Instant(self._number, round(self._base_ns) + own_ns - self._delay_ns, own_ns), values


class NewestOfB:
    """The newest position of encoder B, as long as it is recent."""

    _OLDEST = 2  # reports of A since that of B

    def __init__(self) -> None:
        self._counts: int | None = None
        self._age = 0

    def took(self, counts: int) -> None:
        """Take a position of B."""
        self._counts, self._age = counts, 0

    def at_report_of_a(self) -> int | None:
        """Return the position for the present report of A; None if there is none that is recent."""
        self._age += 1
        return self._counts if self._age <= self._OLDEST else None
