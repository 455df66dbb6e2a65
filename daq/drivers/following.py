"""Detection of a rotor that does not follow the set-point of its controller, or does not slow down when braked."""

from __future__ import annotations

import math

from daq.items import DeviceEvent

_MAX_DEVIATION = (0.2, 30.0)  # relative and absolute (rpm) deviation from the set-point of a rotor that follows
_SLOWER_RPM = 1.0  # least decrease of the speed of a rotor that slows down


class Following:
    """Counter of consecutive reports whose speed deviates from the set-point.

    The duration is counted in reports, so that a stall of the host causes no fault.

    Args:
        device: name of the device in the rig file.
        max_reports: number of deviating reports in a row after which the rotor does not follow.
    """

    def __init__(self, device: str, max_reports: int) -> None:
        self._device, self._max_reports = device, max(3, max_reports)
        self._deviating = 0

    def check(self, commanded: bool, target_rpm: float, actual_rpm: float) -> list[DeviceEvent]:
        """Return a fault if the rotor does not follow, once until it follows again.

        Args:
            commanded: whether the controller is commanded to hold a speed.
            target_rpm, actual_rpm: set-point, and reported speed.
        """
        share, more = _MAX_DEVIATION
        deviates = abs(actual_rpm - target_rpm) > share * abs(target_rpm) + more
        self._deviating = self._deviating + 1 if commanded and deviates else 0
        if self._deviating != self._max_reports:
            return []
        text = (
            f"the rotor does not follow: the set-point is {target_rpm:.0f} rpm, it turns at {actual_rpm:.0f} rpm. "
            "Look at the controller's limits of current and speed, at its own timeout, at whether it may brake"
        )
        return [DeviceEvent("fault", self._device, text, {"target_rpm": target_rpm, "speed_rpm": actual_rpm})]


class SlowingDown:
    """Counter of consecutive reports of a rotor that is braked and does not become slower.

    Args:
        device: name of the device in the rig file.
        max_reports: number of reports in a row, none of them slower than those before, after which it is a fault.
    """

    def __init__(self, device: str, max_reports: int) -> None:
        self._device, self._max_reports = device, max(3, max_reports)
        self._least_rpm = math.inf
        self._reports = 0

    def check(self, braked: bool, actual_rpm: float) -> list[DeviceEvent]:
        """Return a fault if the rotor does not slow down, once until it does.

        Args:
            braked: whether the controller is commanded to brake.
            actual_rpm: reported speed.
        """
        speed_rpm = abs(actual_rpm)
        if not braked or speed_rpm <= _MAX_DEVIATION[1]:
            self._least_rpm, self._reports = math.inf, 0
        elif speed_rpm < self._least_rpm - _SLOWER_RPM:
            self._least_rpm, self._reports = speed_rpm, 0
        else:
            self._reports += 1
        if self._reports != self._max_reports:
            return []
        text = (
            f"the rotor does not slow down: commanded to brake, it turns at {actual_rpm:.0f} rpm. "
            "Look at the brake current, and at whether another input commands the motor"
        )
        return [DeviceEvent("fault", self._device, text, {"target_rpm": 0.0, "speed_rpm": actual_rpm})]
