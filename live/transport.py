"""Position in a replayed log: play, pause, seek, speed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

SLOWEST, FASTEST = 0.01, 100.0
"""Limits of the speed, seconds of the log per second."""


class Transport:
    """Position in a replayed log. It begins at the first instant, playing.

    Args:
        start_s, end_s: first and last instant of the log, s.
        speed: seconds of the log per second.
        clock: elapsed seconds from any origin.

    Attributes:
        jumps: number of jumps to another instant.
    Raises:
        ValueError: the speed is out of range.
    """

    def __init__(
        self, start_s: float, end_s: float, speed: float = 1.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.start_s: float = start_s
        self.end_s: float = end_s
        self.jumps: int = 0
        self._clock = clock
        self._speed = _checked(speed)
        self._at_s, self._since, self._playing = start_s, clock(), True
        self._awaits = False

    @property
    def playing(self) -> bool:
        """Whether the position advances; False at the end."""
        return self._playing and self.at() < self.end_s

    @property
    def speed(self) -> float:
        """Seconds of the log per second during play."""
        return self._speed

    def at(self) -> float:
        """Return the displayed instant."""
        if not self._playing:
            return self._at_s
        return min(self.end_s, self._at_s + self._speed * (self._clock() - self._since))

    def await_viewer(self) -> None:
        """Stay at the start until a viewer looks, or until play or pause is commanded."""
        self._at_s, self._playing, self._awaits = self.start_s, False, True

    def looked_at(self) -> None:
        """Start playing if a viewer was awaited."""
        if self._awaits:
            self.play()

    def play(self) -> None:
        """Continue; at the end, start again from the beginning."""
        self._awaits = False
        if self.at() >= self.end_s:
            self._at_s, self._since = self.start_s, self._clock()
            self.jumps += 1
        elif not self._playing:
            self._since = self._clock()
        self._playing = True

    def pause(self) -> None:
        """Stop at the current instant."""
        self._awaits = False
        self._at_s, self._playing = self.at(), False

    def seek(self, to_s: float) -> None:
        """Jump to the nearest instant within the log; playing continues.

        Raises:
            ValueError: the instant is not finite.
        """
        if not math.isfinite(to_s):
            raise ValueError(f"expected an instant to seek, got {to_s}")
        self._at_s, self._since = min(max(to_s, self.start_s), self.end_s), self._clock()
        self.jumps += 1

    def set_speed(self, speed: float) -> None:
        """Continue from the current instant at another speed.

        Raises:
            ValueError: the speed is out of range.
        """
        checked = _checked(speed)
        self._at_s, self._since = self.at(), self._clock()
        self._speed = checked


def _checked(speed: float) -> float:
    if not SLOWEST <= speed <= FASTEST:
        raise ValueError(f"expected a speed of {SLOWEST:g} to {FASTEST:g} seconds of the log per second, got {speed:g}")
    return speed
