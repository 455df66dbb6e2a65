"""Settings of a VESC motor controller in a rig file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from rig_configs.device import DeviceSettings
from rig_configs.roles import AT_REST_RPM, Role, SpeedSource
from rig_configs.table import Positive

_POLL_BYTES = 6 + 80  # a poll and its answer with every field, framed
_COMMAND_BYTES = 10
_MAX_LINE_SHARE = 0.8  # share of the line's capacity that polls and commands may use in one direction
_MIN_COMMANDS_IN_TIMEOUT = 4
MOST_REST_RPM = 10.0
"""Largest reading that a rig file may count as rest, rpm."""


class VescMotor(DeviceSettings):
    """A VESC motor controller on any line.

    The values stored in the controller can neither be queried nor set by the host. They are therefore stated here,
    without defaults, because a wrong default would not be detected. `docs/protocols/vesc.md` describes how to measure
    them.

    Attributes:
        pole_pairs: number of pole pairs of the motor. The speed on the wire is electrical: pole_pairs times that of the
            rotor. With twice the true number the rotor turns at half the commanded speed.
        timeout_s: controller timeout, s, after which the controller removes the current of a motor that receives no
            command. Its documents state 0.5 s, its firmware 1 s: measure it.
        command_ms: period at which the host repeats its command, ms.
        report_Hz: rate at which the host polls speed and fault, Hz; a late answer delays the next poll.
        ramp_rpm_per_s: rate of the rotor's ramp, rpm/s. The host makes the ramp.
        brake_A: motor current of a stop and of the hold at speed 0, A.
        min_erpm: electrical speed below which the controller cannot hold a speed, rpm; default of the firmware, not
            verified on a motor. The ramp skips lower speeds.
        rest_rpm: largest reading of a standing rotor, rpm.
        follow_s: time for which the speed may differ from the set-point before the rotor counts as not following, s.
    """

    pole_pairs: Annotated[int, Field(ge=1, le=100)]
    timeout_s: Annotated[float, Field(ge=0.1, le=2.0)]
    command_ms: Annotated[int, Field(ge=10, le=200)] = 50
    report_Hz: Annotated[float, Field(ge=10, le=200)] = 50.0
    ramp_rpm_per_s: Annotated[float, Field(gt=0, le=1000)] = 120.0
    brake_A: Annotated[float, Field(gt=0, le=200)]
    min_erpm: Annotated[float, Field(ge=0, le=20_000)] = 900.0
    rest_rpm: Annotated[float, Field(ge=AT_REST_RPM, le=MOST_REST_RPM)] = AT_REST_RPM
    follow_s: Positive = 3.0

    def roles(self, device: str) -> tuple[Role, ...]:
        """See DeviceSettings."""
        return (SpeedSource(device=device, topic="motor", ramp_rpm_per_s=self.ramp_rpm_per_s, rest_rpm=self.rest_rpm),)

    @model_validator(mode="after")
    def _commands_before_timeout(self) -> VescMotor:
        if self.timeout_s * 1e3 < _MIN_COMMANDS_IN_TIMEOUT * self.command_ms:
            raise ValueError(
                f"timeout_s must be at least {_MIN_COMMANDS_IN_TIMEOUT} × command_ms, or a late command stops the rig: "
                f"got {self.timeout_s:g} s and {self.command_ms} ms"
            )
        return self

    @property
    def min_rpm(self) -> float:
        """Least speed of the rotor that the controller holds, rpm."""
        return self.min_erpm / self.pole_pairs


class Vesc(VescMotor):
    """The VESC motor controller on its serial port.

    Attributes:
        baud: line rate of the controller, baud.
    """

    baud: Annotated[int, Field(ge=9600, le=2_000_000)] = 115_200

    @model_validator(mode="after")
    def _line_carries_reports(self) -> Vesc:
        # bit/s, with start and stop bits
        needed = 10 * (_POLL_BYTES * self.report_Hz + _COMMAND_BYTES * 1e3 / self.command_ms)
        if needed > _MAX_LINE_SHARE * self.baud:
            raise ValueError(
                f"report_Hz = {self.report_Hz:g} needs {needed:.0f} of the line's {self.baud} bit/s, more than "
                f"{_MAX_LINE_SHARE:.0%}: reduce report_Hz or raise baud, here and in the controller"
            )
        return self
