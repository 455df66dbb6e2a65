"""Lateness of the host itself, so that what follows from it is not blamed on a device.

The session's tick is periodic. A tick that comes late shows that the host's threads did not run: heartbeats, commands
and reads were as late. The module has no clock; all times are arguments.
"""

from __future__ import annotations

from collections import deque

from daq.acquisition.channel_watch import HOST_S

RECENT_S = 10.0
"""Age up to which a late tick may explain a failure, s: ramps and time-outs of drives last seconds."""


class HostLoad:
    """Latest ticks of a session.

    Args:
        period_s: period of the ticks, s.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._before_ns: int | None = None
        self._late: deque[tuple[int, float]] = deque()  # host ns, lateness, s

    def tick(self, now_ns: int) -> None:
        """Register a tick."""
        if self._before_ns is not None:
            late_s = 1e-9 * (now_ns - self._before_ns) - self._period_s
            if late_s >= HOST_S:
                self._late.append((now_ns, late_s))
        self._before_ns = now_ns

    def words(self, now_ns: int) -> str:
        """Return a sentence about the host if it was late recently; empty if not."""
        while self._late and now_ns - self._late[0][0] > RECENT_S * 1e9:
            self._late.popleft()
        worst_s = max((late_s for _, late_s in self._late), default=0.0)
        if self._before_ns is not None:  # a tick may be due for long
            worst_s = max(worst_s, 1e-9 * (now_ns - self._before_ns) - self._period_s)
        if worst_s < HOST_S:
            return ""
        return (
            f"This host was late by up to {worst_s:.1f} s in the last {RECENT_S:g} s, which can be the cause: end "
            "other programs and repeat, before the device is suspected"
        )
