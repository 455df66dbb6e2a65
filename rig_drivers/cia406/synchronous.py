"""Samples with SYNC: all encoders sample at the same instant, and each SYNC has one report of each encoder.

A report has no number. Two rules keep a report from getting the time of another SYNC than its own:

- An encoder that has not answered a SYNC may still do so after the next one. Its reports are then held until the SYNC
  after that one, and the last of them is the answer (`SyncTimes.holds`). This holds however long ago the SYNC was: a
  host or adapter that stood still passes on the answers of before.
- After a SYNC of another node each encoder sends one report more. A SYNC of this host is doubtful if another node's is
  received before all encoders have answered it, or if reports to another node's were missing when it was sent. Its
  samples are dropped and counted as missing.

Samples without SYNC: each encoder sends by its own timer, at instants that differ between the encoders.

A report has neither a number nor a time. Its time is that of the encoder's timer, mapped to the common clock; missing
reports are a pause of whole periods (daq.numbered). A sample is a report of encoder A with the newest position of B,
which is up to one period older.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from daq.clock import ClockMap
from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream
from rig_drivers.cia406.reports import Instant
from rig_drivers.cia406.settings import LATEST_S

_USUAL = 31  # round trips of which the median is the usual one
_SILENT, _SILENT_NS = 3, round(2e9 * LATEST_S)
_CREEP = 1e-4  # relative rate error of the host's clock, or of a rounded period, that is no missing SYNC
_ROUNDING = 0.02  # of a period, by which the end of whole periods may come early


@dataclass
class _Asked:
    """A SYNC, and the reports that have come since.

    Attributes:
        owed: reports to earlier SYNCs that may still come, by encoder.
        got: reports since this SYNC, by encoder.
        foreign: number of SYNCs of other nodes since this one.
        prompt: whether the first report came in time; None before it.
        doubtful: whether reports may belong to a SYNC of another node.
    """

    number: int
    host_ns: int
    owed: dict[str, int]
    doubtful: bool
    got: Counter[str] = field(default_factory=Counter[str])
    foreign: int = 0
    prompt: bool | None = None


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
        asked, owed, doubtful = self._asked, dict[str, int](), False
        missing = [] if asked is None else [name for name in self._names if not asked.got[name]]
        if asked is not None:
            for name in self._names:
                left = 1 + asked.owed.get(name, 0) + asked.foreign - asked.got[name]
                if left > 0 and (not asked.got[name] or asked.foreign):
                    owed[name] = left
            doubtful = bool(owed and asked.foreign)
        self._asked = _Asked(self._next, host_ns, owed, doubtful)
        self._next += 1
        return missing

    def foreign(self) -> bool:
        """Take a SYNC of another node; return whether the newest SYNC is doubtful."""
        asked = self._asked
        if asked is None:
            return False
        asked.foreign += 1
        asked.doubtful |= any(not asked.got[name] for name in self._names)
        return asked.doubtful

    @property
    def begun(self) -> bool:
        """Whether there was a SYNC; a log may begin between a SYNC and its reports."""
        return self._asked is not None

    @property
    def count(self) -> int:
        """Number of SYNCs."""
        return self._next

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
        return self._asked is None or self._asked.prompt is not False

    @property
    def doubtful(self) -> bool:
        """Whether reports to the newest SYNC may belong to a SYNC of another node."""
        return self._asked is not None and self._asked.doubtful

    @property
    def explains_more(self) -> bool:
        """Whether more than one report of an encoder is expected since the newest SYNC."""
        return self._asked is not None and bool(self._asked.owed or self._asked.foreign or self._asked.doubtful)

    def holds(self, name: str) -> bool:
        """Return whether the next report of an encoder may belong to an earlier SYNC."""
        return self._asked is not None and name in self._asked.owed

    def report(self, name: str, host_ns: int) -> Instant | None:
        """Return the instant of a report, that of its SYNC; None if it answers none, or too late."""
        asked = self._asked
        if asked is None or host_ns - asked.host_ns > LATEST_S * 1e9:
            return None
        if asked.got[name] > asked.owed.get(name, 0):
            asked.got[name] += 1
            return None
        if asked.prompt is None and not asked.doubtful and name not in asked.owed:
            asked.prompt = self._is_prompt(host_ns - asked.host_ns)
        asked.got[name] += 1
        return self.newest


class SilentEncoders:
    """Encoders that have not answered `_SILENT` SYNCs, for `_SILENT_NS` at least: a busy host may miss some answers."""

    def __init__(self) -> None:
        self._missed: dict[str, tuple[int, int]] = {}  # SYNCs without an answer, and time of the first one, ns
        self._reported: set[str] = set()

    def sync(self, missing: list[str], host_ns: int) -> dict[str, int]:
        """Take the encoders that have not answered; return those that are silent from now on, with their SYNCs."""
        self._missed = {name: self._missed.get(name, (0, host_ns)) for name in missing}
        self._reported &= set(missing)
        found: dict[str, int] = {}
        for name, (count, since_ns) in self._missed.items():
            self._missed[name] = count + 1, since_ns
            if count + 1 >= _SILENT and host_ns - since_ns >= _SILENT_NS and name not in self._reported:
                self._reported.add(name)
                found[name] = count + 1
        return found


class SyncSchedule:
    """The periods in which this host has sent no SYNC, because it waited for answers or was busy.

    The host makes up for one SYNC at most, see `RequestLoop`: the SYNC after one that was late by more than a period is
    due at once, and the time by which it was later is lost.

    Args:
        period_ns: period of the SYNCs, ns.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns: float | None = None
        self._lost_ns = 0.0

    def sent(self, host_ns: int) -> int:
        """Take a SYNC; return the number of periods without a SYNC before it."""
        due_ns = host_ns if self._due_ns is None else min(self._due_ns, host_ns)
        next_ns = due_ns + (1 + _CREEP) * self._period_ns
        self._due_ns = max(next_ns, host_ns)
        self._lost_ns += self._due_ns - next_ns
        skipped = int(self._lost_ns / self._period_ns + _ROUNDING)
        self._lost_ns -= skipped * self._period_ns
        return skipped


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
