"""When the next message of a sender is due, by the host's times of its earlier messages.

A message is received after it was sent, and never before. The least delayed messages therefore lie on the lower edge of
their delays. The edge is level if the sender has the stated rate. If it has another one, the delays of all intervals
lie near an inclined line, and far from every level one.

Lateness of messages that wait: whether they remain late, since when, and whether they came at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from daq.clock import lower_line
from daq.numbered.messages import Message

_INTERVAL_NS = 50e6
"""Interval of which the least delayed message is kept: a host under usual load reads in time once in it."""
_INTERVALS = 64
_FEWEST_INTERVALS = 4
_MUCH_CLOSER = 0.25
"""Share of their distance from a level line at which the delays show another rate: noise halves it at best."""
RATE_ERROR: float = 1e-3
"""Error of a stated rate that is not found: ten times that of a quartz, so that rounded rates have room."""
_FIRST_MESSAGES, _FIRST_LATE_NS = 9, 250e6
"""The first messages of a log may all be late, while the host still opens other devices."""


class DueLine:
    """Due times of one sender.

    Args:
        tolerance_ns: time by which a message in time may differ from the line, ns.

    Attributes:
        heard_ns: host time of the newest message, ns.
    """

    def __init__(self, tolerance_ns: float) -> None:
        self.heard_ns: int = 0
        self._tolerance_ns = tolerance_ns
        self._begin_ns: tuple[int, float] | None = None  # host time and sender's time of the first message
        self._least: deque[tuple[float, float, float]] = deque(maxlen=_INTERVALS)  # interval, sender's time, delay
        self._level, self._slope, self._error = 0.0, 0.0, RATE_ERROR
        self._messages = 0

    @property
    def begun(self) -> bool:
        """Whether there was a message."""
        return self._begin_ns is not None

    @property
    def pace(self) -> float:
        """Time between two messages, relative to the stated one."""
        return 1.0 + self._slope

    def take(self, sent_ns: float, host_ns: int, messages: int = 1) -> None:
        """Take the newest of consecutive messages that have their places.

        Args:
            sent_ns: its time by the sender's count, ns.
            host_ns: host time of its read, ns.
            messages: their number.
        """
        if self._begin_ns is None:
            self._begin_ns = host_ns, sent_ns
        self.heard_ns = host_ns
        self._messages += messages
        since_ns, delay_ns = self._relative(sent_ns, host_ns)
        interval = (host_ns - self._begin_ns[0]) // _INTERVAL_NS
        if not self._least or self._least[-1][0] != interval:
            self._fit()
            self._least.append((interval, since_ns, delay_ns))
        elif delay_ns < self._least[-1][2]:
            self._least[-1] = interval, since_ns, delay_ns
        self._level = min(self._level, delay_ns - self._slope * since_ns) if self._messages > 1 else delay_ns

    def late_ns(self, sent_ns: float, host_ns: int) -> float:
        """Return by how much a message is later than the least delayed ones, ns; negative if it comes too early."""
        since_ns, delay_ns = self._relative(sent_ns, host_ns)
        return delay_ns - self._level - self._slope * since_ns

    def tolerance_ns(self, host_ns: int) -> float:
        """Return the uncertainty of a due time after a silence until a host time, ns."""
        return self._tolerance_ns + self._error * max(0, host_ns - self.heard_ns)

    def early_ns(self, host_ns: int) -> float:
        """Return the time by which a message may seem to come too early, ns."""
        return self.tolerance_ns(host_ns) + (_FIRST_LATE_NS if self._messages < _FIRST_MESSAGES else 0.0)

    def _relative(self, sent_ns: float, host_ns: int) -> tuple[float, float]:
        """Return the sender's time since its first message, and the delay relative to that message, ns."""
        host0_ns, sent0_ns = self._begin_ns or (host_ns, sent_ns)
        since_ns = sent_ns - sent0_ns
        return since_ns, host_ns - host0_ns - since_ns

    def _fit(self) -> None:
        """Fit the line to the closed intervals."""
        if not self._least:
            return
        _, sent_ns, delay_ns = zip(*self._least, strict=True)  # few values, for which lists are faster than arrays
        self._level, self._slope, self._error = min(delay_ns), 0.0, RATE_ERROR
        distance = sum(delay_ns) / len(delay_ns) - self._level
        if len(sent_ns) < _FEWEST_INTERVALS or distance < 0.5 * self._tolerance_ns:
            return
        sent, delay = np.array(sent_ns), np.array(delay_ns)
        level, slope = lower_line(sent, delay)
        closer = float(np.mean(delay - level - slope * sent))
        if closer < _MUCH_CLOSER * distance:
            self._level, self._slope = level, slope
            self._error = RATE_ERROR + 2 * closer / float(sent[-1] - sent[0])


_PERSISTS_NS, _PERSISTS_MESSAGES, _PERSISTS_READS = 120e6, 3, 4
"""Messages that stay late for so long were not delayed by the host; they are so many messages and reads at least."""
_CATCHES_UP, _FALLS_BEHIND = 0.25, 0.5
"""Changes of the lateness that no loss explains: relative to itself, and to the time in which it changes."""
_BURST = 0.5
"""Share of the time in which messages were sent, within which they come if they have waited for the host."""


class Lateness(NamedTuple):
    """Lateness of messages that wait.

    Attributes:
        least_ns: least lateness of the newer ones, ns.
        change_ns: by how much it changes, ns; infinite if no loss explains the change.
    """

    least_ns: float
    change_ns: float


def settled_lateness(waiting: Sequence[Message[Any]], tolerance_ns: float, period_ns: float) -> Lateness | None:
    """Return the lateness of messages that have waited long enough; None if they have not.

    Args:
        waiting: at least one message.
        tolerance_ns: lateness of messages in time, ns.
        period_ns: time between two messages, ns.
    """
    begin_ns = waiting[0].host_ns
    passed_ns = waiting[-1].host_ns - begin_ns
    enough_ns = max(_PERSISTS_NS, _PERSISTS_MESSAGES * period_ns)
    if passed_ns < enough_ns:
        return None
    reads = [list(group)[-1] for _, group in groupby(waiting, key=lambda each: each.host_ns)]
    if len(reads) < 2 or (len(reads) < _PERSISTS_READS and passed_ns < 2 * enough_ns):
        return None
    early = min(each.late_ns for each in reads if each.host_ns - begin_ns <= passed_ns / 2)
    late = min(each.late_ns for each in reads if each.host_ns - begin_ns > passed_ns / 2)
    if late < early - max(tolerance_ns, _CATCHES_UP * early):
        return None if passed_ns < 2 * enough_ns else Lateness(late, np.inf)
    falls = late - early >= max(_FALLS_BEHIND * passed_ns / 2, 2 * tolerance_ns)
    return Lateness(late, np.inf if falls else abs(late - early))


def first_late(waiting: Sequence[Message[Any]], late_ns: float, tolerance_ns: float) -> int:
    """Return the index of the message from which on all are so late, or of the first jump in its read."""
    before = [i for i, each in enumerate(waiting) if each.late_ns < late_ns - 0.5 * tolerance_ns]
    first = before[-1] + 1 if before else 0
    of_one_read = [each for each in waiting[first:] if each.host_ns == waiting[first].host_ns]
    return first + next((i for i, each in enumerate(of_one_read) if each.missing), 0)


def came_at_once(waiting: Sequence[Message[Any]], number_ns: float) -> bool:
    """Whether messages have come faster than they were sent; `number_ns` is the time between two numbers, ns."""
    first, newest = waiting[0], waiting[-1]
    sent_ns = (newest.place - first.place) * number_ns
    return len(waiting) == 1 or newest.host_ns - first.host_ns < _BURST * sent_ns
