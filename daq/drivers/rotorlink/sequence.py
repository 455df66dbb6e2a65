"""Counting of lost frames by a sender's seq."""

from __future__ import annotations

from typing import ClassVar


class SequenceCounter:
    """Counts the frames missing from one sender's seq, which wraps at 65536.

    A step back by up to `LATE` is a repeated frame. A larger step back by up to half the wrap is a restart of the
    sender. A restart that looks like a step forward cannot be distinguished from losses: call `reset` if the sender's
    time shows it.
    """

    LATE: ClassVar[int] = 16

    def __init__(self) -> None:
        self.lost: int = 0
        self.repeats: int = 0
        self.restarts: int = 0
        self._last: int | None = None

    def reset(self) -> None:
        """Take note of a restart of the sender: the next seq has no predecessor. The totals are kept."""
        self._last = None

    def go_on(self, seq: int) -> int:
        """Take the next seq after a long silence; return the number of lost frames modulo 65536."""
        lost = 0 if self._last is None else (seq - self._last - 1) & 0xFFFF
        self._last = seq
        self.lost += lost
        return lost

    def is_behind(self, seq: int) -> bool:
        """Whether a number is before the newest one, by less than half the wrap."""
        return self._last is not None and 0 < (self._last - seq) & 0xFFFF < 0x8000

    def feed(self, seq: int, *, again: bool = False) -> tuple[int, bool]:
        """Take the seq of the next frame.

        Args:
            seq: number of the frame.
            again: whether the content was sent before: then an old seq does not indicate a restart.

        Returns:
            Number of frames lost directly before it, and whether it is a repeated frame to be dropped.
        """
        step = 1 if self._last is None else (seq - self._last) & 0xFFFF
        if step == 0 or step >= (0x8000 if again else 0x10000 - self.LATE):
            self.repeats += 1
            return 0, True
        self._last = seq
        if step >= 0x8000:
            self.restarts += 1
            return 0, False
        self.lost += step - 1
        return step - 1, False
