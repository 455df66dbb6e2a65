"""The host's time: the common clock all device clocks are mapped to."""

from __future__ import annotations

import time


class HostClock:
    """Nanoseconds since 1970 that never step back.

    Args:
        rate: seconds of rig time per wall second; 1 on a rig, more where the rig behind the links runs faster.
    """

    def __init__(self, rate: float = 1.0) -> None:
        if not 0.01 <= rate <= 100:
            raise ValueError(f"clock rate must be between 0.01 and 100 rig seconds per second, got {rate}")
        self.rate = rate
        self._monotonic_ns = time.monotonic_ns()
        self._utc_ns = time.time_ns()

    def now_ns(self) -> int:
        """Rig time now, ns since 1970."""
        return self._utc_ns + int((time.monotonic_ns() - self._monotonic_ns) * self.rate)

    def now_s(self) -> float:
        """Rig time now, s since 1970."""
        return self.now_ns() * 1e-9

    def sleep(self, seconds: float) -> None:
        """Wait for some rig time."""
        time.sleep(max(0.0, seconds) / self.rate)

    def wall(self, seconds: float) -> float:
        """How many wall seconds some rig time takes."""
        return seconds / self.rate

    def patience(self, wall_seconds: float) -> float:
        """A time-out that guards against a stalled host or cable, as rig time.

        Such a time-out is a promise in wall time (the host's scheduler does not run faster because the rig does).
        """
        return wall_seconds * max(1.0, self.rate)
