"""Ramps of a speed source: the rate that a device can have, and the host's ramp for a controller without one. Pure."""

from __future__ import annotations

import math

from daq.errors import DeviceError

_MAX_DEVIATION = 0.05  # relative deviation of a device's ramp from the requested one


def check_ramp(wanted: float, nearest: float, why: str) -> None:
    """Raise DeviceError if the nearest ramp that a device can have, rpm/s, is not near the wanted one.

    Args:
        wanted, nearest: rates, rpm/s.
        why: clause about the device's ramps.
    """
    if abs(nearest - wanted) > _MAX_DEVIATION * wanted:
        raise DeviceError(f"drive: {wanted:g} rpm/s wanted; {why}, the nearest ramp is {nearest:g} rpm/s")


class SetpointRamp:
    """A set-point that approaches a target at a limited rate and skips speeds that cannot be held.

    Args:
        rpm_per_s: rate, rpm/s.
        min_rpm: least speed that can be held, rpm; between it and its negative the only set-point is 0.
        longest_s: longest step in time, s. After a stall of the host the set-point continues without a jump.

    Attributes:
        target_rpm: target, rpm.
        rpm: present set-point, rpm.
    """

    def __init__(self, rpm_per_s: float, min_rpm: float, longest_s: float) -> None:
        self.rpm_per_s = rpm_per_s
        self.target_rpm: float = 0.0
        self.rpm: float = 0.0
        self._min_rpm, self._longest_s = min_rpm, longest_s
        self._now_s: float | None = None

    def begin(self, rpm: float, now_s: float) -> None:
        """Set the present set-point, with 0 as target."""
        self.rpm = rpm if abs(rpm) >= self._min_rpm else 0.0
        self.target_rpm, self._now_s = 0.0, now_s

    def at(self, now_s: float) -> float:
        """Advance to a time, s; return the set-point, rpm."""
        passed = 0.0 if self._now_s is None else min(max(0.0, now_s - self._now_s), self._longest_s)
        self._now_s = now_s
        step = self.rpm_per_s * passed
        rpm = self.rpm + min(max(self.target_rpm - self.rpm, -step), step)
        if abs(rpm) < self._min_rpm:
            rpm = math.copysign(self._min_rpm, self.target_rpm) if abs(self.target_rpm) >= self._min_rpm else 0.0
        self.rpm = rpm
        return rpm
