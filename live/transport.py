# pyright: strict
"""Where a log that is played stands: play, pause, seek, speed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

SLOWEST, FASTEST = 0.01, 100.0
"""Seconds of the log per second."""


class Transport:
    """It begins at the log's first instant, playing.

    Args:
        start_s, end_s: of what is played.
        speed: seconds of it per second.
        clock: seconds that pass, from any zero.

    Attributes:
        jumps: how often it went to another instant than the next.
    Raises:
        ValueError: a speed out of range.
    """

    def __init__(
        self, start_s: float, end_s: float, speed: float = 1.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.start_s, self.end_s = start_s, end_s
        self.jumps = 0
        self._clock = clock
        self._speed = _checked(speed)
        self._at_s, self._since, self._playing = start_s, clock(), True
        self._awaits = False

    @property
    def playing(self) -> bool:
        """Whether it moves on; not at the end."""
        return self._playing and self.at() < self.end_s

    @property
    def speed(self) -> float:
        """Seconds of the log per second while it plays."""
        return self._speed

    def at(self) -> float:
        """The instant that is shown."""
        if not self._playing:
            return self._at_s
        return min(self.end_s, self._at_s + self._speed * (self._clock() - self._since))

    def await_viewer(self) -> None:
        """Stand at the beginning until somebody looks, or plays or pauses it by hand."""
        self._at_s, self._playing, self._awaits = self.start_s, False, True

    def looked_at(self) -> None:
        """Somebody looks: play, where that was waited for."""
        if self._awaits:
            self.play()

    def play(self) -> None:
        """Go on; from the end, begin again."""
        self._awaits = False
        if self.at() >= self.end_s:
            self._at_s, self._since = self.start_s, self._clock()
            self.jumps += 1
        elif not self._playing:
            self._since = self._clock()
        self._playing = True

    def pause(self) -> None:
        """Stand where it is."""
        self._awaits = False
        self._at_s, self._playing = self.at(), False

    def seek(self, to_s: float) -> None:
        """Go to an instant; one outside means the nearest inside. It plays on if it did.

        Raises:
            ValueError: no instant.
        """
        if not math.isfinite(to_s):
            raise ValueError(f"expected an instant to seek, got {to_s}")
        self._at_s, self._since = min(max(to_s, self.start_s), self.end_s), self._clock()
        self.jumps += 1

    def set_speed(self, speed: float) -> None:
        """Go on from here at another speed.

        Raises:
            ValueError: out of range.
        """
        checked = _checked(speed)
        self._at_s, self._since = self.at(), self._clock()
        self._speed = checked


def _checked(speed: float) -> float:
    if not SLOWEST <= speed <= FASTEST:
        raise ValueError(f"expected a speed of {SLOWEST:g} to {FASTEST:g} seconds of the log per second, got {speed:g}")
    return speed
