"""Samples with SYNC: all encoders sample at the same instant, and each SYNC has one report of each encoder."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from daq.drivers.cia406.reports import Instant
from daq.drivers.cia406.settings import LATEST_S

_USUAL = 31  # round trips of which the median is the usual one


@dataclass
class _Asked:
    """A SYNC, the encoders that have answered it, and whether its first report came in time."""

    number: int
    host_ns: int
    answered: set[str] = field(default_factory=set[str])
    prompt: bool = True


class SyncTimes:
    """Assigns reports to the SYNC that they answer, and counts missing ones exactly.

    All encoders sample at the SYNC on the bus, between the host's write and the arrival of the first report. A first
    report that is later than usual may therefore mean a SYNC that left late, and a sampling later than assumed; or only
    a host that read late, which moves no time.

    Args:
        names: names of the encoders.
        delay_ns: time from the host's write of a SYNC to the sampling, ns.
        max_lateness_ns: longest time by which a first report may be later than usual, ns.

    Attributes:
        usual_ns: median of the newest round trips, ns; each from the write to the first report.
    """

    def __init__(self, names: tuple[str, ...], delay_ns: int, max_lateness_ns: int) -> None:
        self._names, self._delay_ns, self._max_lateness_ns = names, delay_ns, max_lateness_ns
        self._round_trips: deque[int] = deque(maxlen=_USUAL)
        self.usual_ns: int = 0
        self._asked: _Asked | None = None
        self._next = 0

    def sync(self, host_ns: int) -> list[str]:
        """Take a SYNC; return the names of the encoders that have not answered the one before."""
        asked = self._asked
        missing = [] if asked is None else [name for name in self._names if name not in asked.answered]
        self._asked = _Asked(self._next, host_ns)
        self._next += 1
        return missing

    @property
    def begun(self) -> bool:
        """Whether there was a SYNC; a log may begin between a SYNC and its reports."""
        return self._asked is not None

    @property
    def newest(self) -> Instant | None:
        """Instant of the newest SYNC."""
        if self._asked is None:
            return None
        time_ns = self._asked.host_ns + self._delay_ns
        return Instant(self._asked.number, time_ns, time_ns)

    def _is_prompt(self, round_trip_ns: int) -> bool:
        self._round_trips.append(round_trip_ns)
        self.usual_ns = sorted(self._round_trips)[len(self._round_trips) // 2]
        return round_trip_ns - self.usual_ns <= self._max_lateness_ns

    @property
    def prompt(self) -> bool:
        """Whether the first report of the newest SYNC came in time."""
        return self._asked is None or self._asked.prompt

    def report(self, name: str, host_ns: int) -> Instant | None:
        """Return the instant of a report, that of its SYNC; None if it answers none, or too late."""
        asked = self._asked
        if asked is None or name in asked.answered or host_ns - asked.host_ns > LATEST_S * 1e9:
            return None
        if not asked.answered:
            asked.prompt = self._is_prompt(host_ns - asked.host_ns)
        asked.answered.add(name)
        return self.newest
