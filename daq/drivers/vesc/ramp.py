# pyright: strict
"""The ramp that a controller without one of its own is led along. Pure: the time is given."""

from __future__ import annotations

import math


class Ramp:
    """A set-point that goes towards a target at a limited rate, and leaves out speeds that cannot be held.

    Args:
        rpm_per_s: rate.
        min_rpm: least speed that can be held; between it and its negative the only set-point is 0.
        longest_s: longest step in time; a host that was asleep goes on where it was, it does not leap.

    Attributes:
        target_rpm: where it goes.
        rpm: where it is.
    """

    def __init__(self, rpm_per_s: float, min_rpm: float, longest_s: float) -> None:
        self.rpm_per_s = rpm_per_s
        self.target_rpm = self.rpm = 0.0
        self._min_rpm, self._longest_s = min_rpm, longest_s
        self._now_s: float | None = None

    def begin(self, rpm: float, now_s: float) -> None:
        """Stand at a speed, with 0 as target."""
        self.rpm = rpm if abs(rpm) >= self._min_rpm else 0.0
        self.target_rpm, self._now_s = 0.0, now_s

    def at(self, now_s: float) -> float:
        """Go on to a time; returns the set-point, rpm."""
        passed = 0.0 if self._now_s is None else min(max(0.0, now_s - self._now_s), self._longest_s)
        self._now_s = now_s
        step = self.rpm_per_s * passed
        rpm = self.rpm + min(max(self.target_rpm - self.rpm, -step), step)
        if abs(rpm) < self._min_rpm:
            rpm = math.copysign(self._min_rpm, self.target_rpm) if abs(self.target_rpm) >= self._min_rpm else 0.0
        self.rpm = rpm
        return rpm
