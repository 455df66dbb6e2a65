"""When the next message of a sender is due, by the host's times of its earlier messages.

A message is received after it was sent, and never before. The least delayed messages therefore lie on the lower edge of
their delays. The edge is level if the sender has the stated rate. If it has another one, the delays of all intervals
lie near an inclined line, and far from every level one.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from daq.clock import lower_line

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

    def take(self, sent_ns: float, host_ns: int) -> None:
        """Take a message that has its place; `sent_ns` is its time by the sender's count, ns."""
        if self._begin_ns is None:
            self._begin_ns = host_ns, sent_ns
        self.heard_ns = host_ns
        self._messages += 1
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
        sent = np.array([entry[1] for entry in self._least])
        delay = np.array([entry[2] for entry in self._least])
        self._level, self._slope, self._error = float(delay.min()), 0.0, RATE_ERROR
        distance = float(delay.mean()) - self._level
        if len(sent) < _FEWEST_INTERVALS or distance < 0.5 * self._tolerance_ns:
            return
        level, slope = lower_line(sent, delay)
        closer = float(np.mean(delay - level - slope * sent))
        if closer < _MUCH_CLOSER * distance:
            self._level, self._slope = level, slope
            self._error = RATE_ERROR + 2 * closer / float(sent[-1] - sent[0])
