"""A sender's clock of 32 bits in µs. It wraps after 71.6 min and starts at 0 when the sender starts."""

from __future__ import annotations

_WRAP_US = 2**32
_MAX_LATE_US = 1_000_000  # a frame older than the newest by up to this is late, not a step back of the clock
_MAX_HOST_LATE_US = 120_000_000  # largest lateness of a host
_MAX_RADIO_LATE_US = 10_000_000  # of a frame that a radio repeats; a Zigbee module ends its tries after 4.8 s
_MAX_NEWEST_LATE_US = 2_000_000  # of the newest frame, which is seldom a repeated one


class SenderClock:
    """Unwraps the clock and detects a restart: from a step back of the clock, or from the host's time."""

    def __init__(self) -> None:
        self._newest: tuple[int, int] | None = None  # unwrapped time of the sender, µs; host time, ns

    @property
    def newest_us(self) -> int:
        """Newest time taken, unwrapped, µs; 0 before the first."""
        return 0 if self._newest is None else self._newest[0]

    def has_restarted(self, sender_us: int, host_ns: int, span_us: int = 0) -> bool:
        """Take the time of a frame; return whether the sender has restarted. Then a new `SenderClock` is needed.

        Args:
            sender_us: time of the sender in the frame, µs, wrapped.
            host_ns: host time of the frame, ns since 1970.
            span_us: time from the first to the newest sample of the frame, µs. If the clock wraps between them in the
                first frame, unwrapped times begin one wrap later, so that none is negative.
        """
        if self._newest is None:
            self._newest = sender_us + _WRAP_US * (sender_us < span_us), host_ns
            return False
        newest_us, newest_ns = self._newest
        passed_us = (host_ns - newest_ns) // 1000
        ahead_us = self.unwrap(sender_us) - newest_us
        ahead_us += _WRAP_US * max(0, round((passed_us - ahead_us) / _WRAP_US))
        if ahead_us < -_MAX_LATE_US or ahead_us - passed_us > _MAX_HOST_LATE_US:
            return True
        if ahead_us > 0:
            self._newest = newest_us + ahead_us, host_ns
        return False

    def is_late(self, sender_us: int, host_ns: int, up_us: int) -> bool:
        """Whether a frame was sent before the newest one, by up to 10 s, and not after a restart of the sender.

        A sender that has restarted since the newest frame cannot have run for longer than since then.

        Args:
            sender_us: time of the sender in the frame, µs, wrapped.
            host_ns: host time of the frame, ns since 1970.
            up_us: time for which the sender had run when it sent the frame, µs, or less.
        """
        if self._newest is None:
            return False
        newest_us, newest_ns = self._newest
        passed_us = max(0, host_ns - newest_ns) // 1000
        behind_us = newest_us - self.unwrap(sender_us)
        return 0 < behind_us <= _MAX_RADIO_LATE_US and up_us > passed_us + _MAX_NEWEST_LATE_US

    def unwrap(self, sender_us: int) -> int:
        """Return the unwrapped time, µs, of a wrapped time near the newest one."""
        if self._newest is None:
            return sender_us
        newest_us = self._newest[0]
        return newest_us + (sender_us - newest_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2
