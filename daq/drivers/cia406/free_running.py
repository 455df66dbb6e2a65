"""Samples without SYNC: each encoder sends by its own timer, at instants that differ between the encoders.

A report has neither a number nor a time. Its time is that of the encoder's timer, which is followed by the earliest
arrivals; a missing report is a pause of whole periods. The angle of encoder B is interpolated to the instants of
encoder A.
"""

from __future__ import annotations

from collections import deque

from daq.drivers.cia406.reports import Report

_DRIFT = 1e-3  # largest rate error of an encoder's timer that is followed
_TIMELY = 0.1  # of a period, by which a report after a pause of whole periods may come too early
_BACKLOG = 0.5  # of a period: reports that come faster were delayed on their way
_WAITING = 64  # samples of A that wait for the next report of B
_WIDEST = 2.5  # periods between two reports of B between which its angle is interpolated


class OwnTimer:
    """Times of one encoder's reports.

    A report that comes late by a whole period or more waits for the next one. If that one follows at once, both were
    delayed on their way, otherwise the reports in between are missing.

    Args:
        period_ns: period of the encoder's timer, ns.
        delay_ns: time from the sampling to the host's read, ns.
    """

    def __init__(self, period_ns: int, delay_ns: int) -> None:
        self._period_ns, self._delay_ns = period_ns, delay_ns
        self._number = -1
        self._base_ns = 0.0  # time of report 0, by the earliest arrivals
        self._held: tuple[int, int] | None = None
        self.missing: int = 0

    def feed(self, counts: int, host_ns: int) -> list[Report]:
        """Take a report; return the reports whose times are known now."""
        if self._number < 0:
            self._number, self._base_ns = 0, float(host_ns)
            return [self._report(counts)]
        out: list[Report] = []
        if self._held is not None:
            held, self._held = self._held, None
            delayed = host_ns - held[1] < _BACKLOG * self._period_ns
            out.append(self._take(*held, 0 if delayed else self._late(held[1])))
        if self._late(host_ns):
            self._held = counts, host_ns
        else:
            out.append(self._take(counts, host_ns, 0))
        return out

    def end(self) -> list[Report]:
        """Return the report that waits."""
        held, self._held = self._held, None
        return [] if held is None else [self._take(*held, self._late(held[1]))]

    def _late(self, host_ns: int) -> int:
        """Return the number of whole periods by which a report comes late."""
        due_ns = self._base_ns + (self._number + 1) * self._period_ns
        return max(0, int((host_ns - due_ns) / self._period_ns + _TIMELY))

    def _take(self, counts: int, host_ns: int, missing: int) -> Report:
        self.missing += missing
        self._number += 1 + missing
        drifted = self._base_ns + _DRIFT * (1 + missing) * self._period_ns
        self._base_ns = min(drifted, float(host_ns - self._number * self._period_ns))
        return self._report(counts)

    def _report(self, counts: int) -> Report:
        own_ns = self._number * self._period_ns
        return Report(self._number, round(self._base_ns) + own_ns - self._delay_ns, own_ns, counts)


class Pairs:
    """Both angles at the instants of encoder A; that of B is interpolated.

    Args:
        period_ns: period of the encoders' timers, ns.

    Attributes:
        missing: number of reports of A for which B has none close enough.
    """

    def __init__(self, period_ns: int) -> None:
        self._widest_ns = _WIDEST * period_ns
        self._waiting: deque[Report] = deque()
        self._before: Report | None = None  # the newest report of B, and the one before it
        self._after: Report | None = None
        self.missing: int = 0

    def feed_a(self, report: Report) -> list[tuple[Report, float]]:
        """Take a report of A; return reports of A with the position of B, counts."""
        self._waiting.append(report)
        if len(self._waiting) > _WAITING:
            self._waiting.popleft()
            self.missing += 1
        return self._ready()

    def feed_b(self, report: Report) -> list[tuple[Report, float]]:
        """Take a report of B; return reports of A with the position of B, counts."""
        out = self._ready()
        self._before, self._after = self._after, report
        return out + self._ready()

    def _ready(self) -> list[tuple[Report, float]]:
        before, after = self._before, self._after
        out: list[tuple[Report, float]] = []
        while self._waiting and after is not None and self._waiting[0].time_ns <= after.time_ns:
            report = self._waiting.popleft()
            if before is None:  # the recording began between the two encoders' reports
                continue
            span = after.time_ns - before.time_ns
            if span > self._widest_ns or not 0 <= report.time_ns - before.time_ns <= span:
                self.missing += 1
                continue
            share = (report.time_ns - before.time_ns) / max(1, span)
            out.append((report, before.counts + share * (after.counts - before.counts)))
        return out
