"""Samples without SYNC: each encoder sends by its own timer, at instants that differ between the encoders.

A report has neither a number nor a time. Its time is that of the encoder's timer, mapped to the common clock; missing
reports are a pause of whole periods (daq.numbered). A sample is a report of encoder A with the newest position of B,
which is up to one period older.
"""

from __future__ import annotations

import numpy as np

from daq.clock import ClockMap
from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream
from rig_drivers.cia406.reports import Instant

_TIMER_PPM = 200.0
"""Standard uncertainty of an encoder's timer: it counts milliseconds by a crystal or a trimmed oscillator."""

Values = tuple[int, ...]


class OwnTimer:
    """Times of one encoder's reports, which are messages without a number.

    Args:
        period_ns: period of the encoder's timer, ns.
        delay_ns: time from the sampling to the host's read, ns.

    Attributes:
        missing: number of missing reports.
    """

    def __init__(self, period_ns: int, delay_ns: int) -> None:
        self.missing: int = 0
        self._period_ns, self._delay_ns = period_ns, delay_ns
        self._reports = NumberedStream[list[Values]](Count(1, period_ns), chained)
        self._clock = ClockMap(_TIMER_PPM)

    def feed(self, values: Values, host_ns: int) -> list[tuple[Instant, Values]]:
        """Take a report; return the reports whose times are known now, with their values."""
        return self._timed(self._reports.feed(np.zeros(1, np.int64), [values], host_ns))

    def end(self) -> list[tuple[Instant, Values]]:
        """Return the reports that wait: no report in time follows them."""
        return self._timed(self._reports.end())

    def _timed(self, found: list[Stretch[list[Values]]]) -> list[tuple[Instant, Values]]:
        out: list[tuple[Instant, Values]] = []
        for stretch in found:
            self.missing += stretch.lost
            own_ns = stretch.numbers * self._period_ns
            time_ns = self._clock.map(own_ns, stretch.host_ns) - self._delay_ns
            for number, at_ns, its_ns, values in zip(stretch.numbers, time_ns, own_ns, stretch.rows, strict=True):
                out.append((Instant(int(number), int(at_ns), int(its_ns)), values))
        return out


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
