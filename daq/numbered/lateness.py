"""Lateness of messages that wait: whether they remain late, since when, and whether they came at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from daq.numbered.messages import Message

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
