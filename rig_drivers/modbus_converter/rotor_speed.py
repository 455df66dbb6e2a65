"""Speed of the rotor from the reports of a converter, which reports 0 Hz at any speed while its output is off."""

from __future__ import annotations

import math

from rig_drivers.modbus_converter import registers
from rig_drivers.modbus_converter.settings import ModbusConverter

_SLACK = 1.5  # factor on the drop of speed that a stop along a ramp can cause between two reports


class RotorSpeed:
    """Speed of the rotor; NaN if the output was switched off while the rotor turned.

    State and speed are read by two requests if their registers are far apart, and the output may be switched off
    between them. Then the report consists of "running" and of speed 0, which no ramp explains. One such report has no
    speed; from the second one on, the speed of a converter that runs is taken as it is.

    Args:
        settings: table of the converter in the rig file.
    """

    def __init__(self, settings: ModbusConverter) -> None:
        self._settings = settings
        self._ran: tuple[int, float] | None = None  # time and speed of the last report while running
        self._doubted = False  # whether the last report was "running" with a speed of 0 that no ramp explains
        self._released = False  # whether the output was switched off at speed

    def reported(self, state: str, rpm: float, host_ns: int, *, stopping: bool) -> float:
        """Take a report and return the speed of the rotor, rpm.

        Args:
            state: state of the converter.
            rpm: speed for the reported frequency, rpm.
            host_ns: time of the report, ns since 1970.
            stopping: whether the host's last command is a stop.
        """
        rest = self._settings.rest_rpm
        if state == registers.RUNNING:
            ran, self._released = self._ran, False
            if not self._doubted and ran is not None and abs(rpm) <= rest:
                self._doubted = abs(ran[1]) > self._largest_drop(ran[0], host_ns, stopping=stopping)
                if self._doubted:
                    return math.nan
            self._ran, self._doubted = (host_ns, rpm), False
        elif self._ran is not None:
            ran_ns, ran_rpm = self._ran
            limit = rest if state == registers.FAULT else self._largest_drop(ran_ns, host_ns, stopping=stopping)
            self._released, self._ran, self._doubted = abs(ran_rpm) > limit, None, False
        return math.nan if self._released else rpm

    def restarted(self) -> bool:
        """Take that the converter lost its supply, and so its output was off. Return whether the rotor may turn."""
        if self._ran is not None:
            self._released, self._ran = abs(self._ran[1]) > self._settings.rest_rpm, None
        return self._released

    def _largest_drop(self, since_ns: int, host_ns: int, *, stopping: bool) -> float:
        """Return the drop of speed that a ramp may have caused since a report, rpm.

        Without a stop of the host, the converter decelerates only after its communication timeout.
        """
        s, elapsed_s = self._settings, (host_ns - since_ns) * 1e-9
        rate = s.quick_rpm_per_s
        if not stopping:
            rate, elapsed_s = s.ramp_rpm_per_s, max(0.0, elapsed_s - s.watchdog_s)
        return _SLACK * rate * elapsed_s + s.rest_rpm
