"""Numbers and clock of one sender's frames: what is lost, what comes again, and whether the sender has started again.

The seq counts frames of all types and wraps at 65536. The clock has 32 bits in µs: it wraps after 71.6 min and starts
at 0 when the sender starts.
"""

from __future__ import annotations

from typing import NamedTuple

_WRAP_US = 2**32
_LATE = 16
"""Frames by which a repeated one comes later; a seq that is further back shows a restart."""
_MAX_SILENCE_US = 30_000_000  # after a longer silence the seq, which wraps, does not show a restart
_MAX_LATE_US = 1_000_000  # a frame older than the newest by up to this is late, not a step back of the clock
_MAX_HOST_LATE_US = 120_000_000  # largest lateness of a host
_MAX_RADIO_LATE_US = 10_000_000  # of a frame that a radio repeats; a Zigbee module ends its tries after 4.8 s
_MAX_NEWEST_LATE_US = 2_000_000  # of the newest frame, which is seldom a repeated one


class Place(NamedTuple):
    """Place of a frame among those of its sender.

    Attributes:
        lost: number of frames missing before it, modulo 65536.
        span_s: time since the newest frame with a time, s; 0 if it is unknown.
        is_repeated: whether it has come before, or too late.
        is_restart: whether its sender has started again; a new `Sender` must take it.
    """

    lost: int = 0
    span_s: float = 0.0
    is_repeated: bool = False
    is_restart: bool = False


class Sender:
    """See the module."""

    def __init__(self) -> None:
        self._seq: int | None = None
        self._stated_us: int | None = None  # newest stated time
        self._newest: tuple[int, int] | None = None  # unwrapped time of the sender, µs; host time, ns

    def feed(self, seq: int, us: int | None, host_ns: int, *, span_us: int = 0, is_old: bool = False) -> Place:
        """Take a frame.

        Args:
            seq: its number.
            us: time of the sender in it, µs, wrapped; None without one.
            host_ns: host time of its arrival, ns since 1970.
            span_us: time from its first to its newest sample, µs. If the clock wraps between them in the first frame,
                unwrapped times begin one wrap later, so that none is negative.
            is_old: whether its content was sent before: then an old seq shows no restart.
        """
        before_us = 0 if self._newest is None else self._newest[0]
        newest_us = before_us if us is None else self._newest_us((us + span_us) % _WRAP_US, host_ns, span_us)
        if newest_us is None:
            return Place(is_restart=True)
        step = 1 if self._seq is None else (seq - self._seq) & 0xFFFF
        if newest_us - before_us <= _MAX_SILENCE_US:
            if step == 0 or step >= (0x8000 if is_old else 0x10000 - _LATE):
                return Place(is_repeated=True)
            if step >= 0x8000:
                return Place(is_restart=True)
        self._seq = seq
        return Place((step - 1) & 0xFFFF, self._passed_s(us))

    def is_behind(self, seq: int) -> bool:
        """Whether a number is before the newest one, by less than half the wrap."""
        return self._seq is not None and 0 < (self._seq - seq) & 0xFFFF < 0x8000

    def is_late(self, us: int, host_ns: int, up_us: int) -> bool:
        """Whether a frame was sent before the newest one, by up to 10 s, and not after a restart of the sender.

        A sender that has restarted since the newest frame cannot have run for longer than since then.

        Args:
            us: time of the sender in the frame, µs, wrapped.
            host_ns: host time of the frame, ns since 1970.
            up_us: time for which the sender had run when it sent the frame, µs, or less.
        """
        if self._newest is None:
            return False
        newest_us, newest_ns = self._newest
        passed_us = max(0, host_ns - newest_ns) // 1000
        behind_us = newest_us - self.unwrap(us)
        return 0 < behind_us <= _MAX_RADIO_LATE_US and up_us > passed_us + _MAX_NEWEST_LATE_US

    def unwrap(self, us: int) -> int:
        """Return the unwrapped time, µs, of a wrapped time near the newest one."""
        if self._newest is None:
            return us
        newest_us = self._newest[0]
        return newest_us + (us - newest_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2

    def _newest_us(self, us: int, host_ns: int, span_us: int) -> int | None:
        """Take a time; return the newest one, unwrapped. None: it has stepped back, or runs ahead of the host's."""
        if self._newest is None:
            self._newest = us + _WRAP_US * (us < span_us), host_ns
            return self._newest[0]
        newest_us, newest_ns = self._newest
        passed_us = (host_ns - newest_ns) // 1000
        ahead_us = self.unwrap(us) - newest_us
        ahead_us += _WRAP_US * max(0, round((passed_us - ahead_us) / _WRAP_US))
        if ahead_us < -_MAX_LATE_US or ahead_us - passed_us > _MAX_HOST_LATE_US:
            return None
        if ahead_us > 0:
            self._newest = newest_us + ahead_us, host_ns
        return self._newest[0]

    def _passed_s(self, us: int | None) -> float:
        """Take a stated time; return the time since the newest one, s; 0 for the wrong order."""
        if us is None:
            return 0.0
        passed_us = 0 if self._stated_us is None else (us - self._stated_us) % _WRAP_US
        if passed_us >= _WRAP_US // 2:
            return 0.0
        self._stated_us = us
        return passed_us * 1e-6
