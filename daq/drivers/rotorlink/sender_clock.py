# pyright: strict
"""A sender's clock of 32 bits in µs: it wraps after 71.6 min, and begins at 0 whenever the sender does."""

from __future__ import annotations

_WRAP_US = 2**32
_LATE_US = 1_000_000  # what was made before and comes behind is no step back
_APART_US = 120_000_000  # more than a host can be late


class SenderClock:
    """Unwraps the clock and notices a new beginning: by the clock alone where it falls, else by the host's time."""

    def __init__(self) -> None:
        self._newest: tuple[int, int] | None = None  # the sender's time, unwrapped, µs; the host's, ns

    @property
    def newest_us(self) -> int:
        """The newest time taken, unwrapped, µs; 0 before any."""
        return 0 if self._newest is None else self._newest[0]

    def begins_anew(self, sender_us: int, host_ns: int) -> bool:
        """Whether the sender has started again; what it says then is not taken, a new clock has to.

        Args:
            sender_us: its time in a frame.
            host_ns: when that came.
        """
        if self._newest is None:
            self._newest = sender_us, host_ns
            return False
        newest_us, newest_ns = self._newest
        passed_us = (host_ns - newest_ns) // 1000
        ahead_us = self.unwrap(sender_us) - newest_us
        ahead_us += _WRAP_US * max(0, round((passed_us - ahead_us) / _WRAP_US))
        if ahead_us < -_LATE_US or ahead_us - passed_us > _APART_US:
            return True
        if ahead_us > 0:
            self._newest = newest_us + ahead_us, host_ns
        return False

    def unwrap(self, sender_us: int) -> int:
        """An instant near the newest one, µs that grow for ever."""
        if self._newest is None:
            return sender_us
        newest_us = self._newest[0]
        return newest_us + (sender_us - newest_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2
