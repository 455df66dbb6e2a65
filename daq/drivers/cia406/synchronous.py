"""Samples with SYNC: all encoders sample at the same instant, and each SYNC has one report of each encoder."""

from __future__ import annotations

from dataclasses import dataclass, field

from daq.drivers.cia406.reports import Instant
from daq.drivers.cia406.settings import LATEST_S


@dataclass
class _Asked:
    """A SYNC, the encoders that have answered it, and whether its first report came in time."""

    number: int
    host_ns: int
    answered: set[str] = field(default_factory=set[str])
    prompt: bool = True


class SyncTimes:
    """Assigns reports to the SYNC that they answer, and counts missing ones exactly.

    All encoders sample at the SYNC on the bus, between the host's write and the arrival of the first report. The latter
    therefore bounds the error of the time of all of them.

    Args:
        names: names of the encoders.
        delay_ns: time from the host's write of a SYNC to the sampling, ns.
        max_round_trip_ns: longest time from the write to the first report for which the time is certain enough, ns.
    """

    def __init__(self, names: tuple[str, ...], delay_ns: int, max_round_trip_ns: int) -> None:
        self._names, self._delay_ns, self._max_round_trip_ns = names, delay_ns, max_round_trip_ns
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
    def prompt(self) -> bool:
        """Whether the first report of the newest SYNC came in time."""
        return self._asked is None or self._asked.prompt

    def report(self, name: str, host_ns: int) -> Instant | None:
        """Return the instant of a report, that of its SYNC; None if it answers none, or too late."""
        asked = self._asked
        if asked is None or name in asked.answered or host_ns - asked.host_ns > LATEST_S * 1e9:
            return None
        if not asked.answered:
            asked.prompt = host_ns - asked.host_ns <= self._max_round_trip_ns
        asked.answered.add(name)
        time_ns = asked.host_ns + self._delay_ns
        return Instant(asked.number, time_ns, time_ns)
