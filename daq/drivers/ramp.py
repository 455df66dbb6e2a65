"""Ramps of a speed source: the rate that a device can have, and the host's ramp for a controller without one. Pure.

Wait until a rotor that was commanded to stop stands, as long as its speed decreases.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from daq.drivers.contract import RotorGuard
from daq.errors import DeviceError, LinkLost
from daq.transports.host_clock import HostClock

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


REPEAT_S = 0.25
"""Time between two commands to stop or to release a rotor, of which one may be lost, s."""
_MAX_RUN_DOWN_S = 60.0  # s that a rotor without torque may need to stop
_MAX_CONSTANT_S = 5.0  # s without decrease of the speed after which the wait ends
_MAX_SEND_FAILURES = 3  # commands that may fail to be sent before the wait ends
_RETRY_S = 0.05  # s from a command that failed to be sent to the next one
_NOTIFY_EVERY_S = 2.0  # s between two texts about the wait


def wait_for_rest(
    clock: HostClock, rotor: RotorGuard, command: Callable[[], None], notify: Callable[[str], None]
) -> bool:
    """Command a stop, and repeat it until the rotor stands.

    Args:
        clock: clock for the waits.
        rotor: source of whether the rotor stands, and of its speed.
        command: sends the stop command; it is sent once even if the rotor stands, because it may have a target speed.
        notify: called with a text about what is being waited for.

    Returns:
        Whether the rotor stands. False if its speed does not decrease, the run-down takes too long, or its speed is
        unknown.

    Raises:
        LinkLost: commands cannot be sent any more.
    """
    begun = slower = notified = next_s = clock.now_s()
    least, failures = math.inf, 0
    while True:
        now = clock.now_s()
        if now >= next_s:
            next_s = now + REPEAT_S
            try:
                command()
            except LinkLost:  # one frame was not accepted, or the line is lost
                failures += 1
                if failures > _MAX_SEND_FAILURES:
                    raise
                next_s = now + _RETRY_S
        rest, speed = rotor.at_rest(), rotor.speed_rpm()
        if rest:
            return True
        if not speed > least - 1.0:  # also if no device reports the speed (NaN): then index marks alone decide
            slower, least = now, speed
        too_long = now - begun > _MAX_RUN_DOWN_S or now - slower > _MAX_CONSTANT_S
        if too_long or (rest is None and now - begun > _MAX_CONSTANT_S):
            return False
        if now - notified > _NOTIFY_EVERY_S:
            notify("waiting for the rotor to stop" + ("" if math.isnan(speed) else f", {speed:.0f} rpm"))
            notified = now
        clock.wait(0.01)
