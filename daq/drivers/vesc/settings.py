# pyright: strict
"""The table of a VESC motor controller in a rig file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from rig_configs.device import DeviceSettings
from rig_configs.roles import AT_REST_RPM, Role, SpeedSource
from rig_configs.table import Positive

_POLL_BYTES = 6 + 80  # of a poll and its answer with every field, framed
_COMMAND_BYTES = 10
_LINE_SHARE = 0.8  # of the line's capacity that polls and commands may take, one way
_COMMANDS_IN_TIMEOUT = 4


class Vesc(DeviceSettings):
    """The VESC motor controller on its serial port.

    The controller offers no way to ask for, or to set, the numbers its operator has stored in it; so they are stated
    here, and none of them has a default that could be wrong unseen. `docs/protocols/vesc.md` tells how to measure them.

    Attributes:
        pole_pairs: of the motor; the speed on the wire is electrical, pole_pairs times the rotor's. Twice the number
            and the rotor turns at half the speed wanted.
        timeout_s: the controller's own time-out, after which it lets go of a motor that nobody commands. Its
            documents say 0.5 s, its firmware 1 s: measure it.
        command_ms: how often the host repeats its command.
        report_Hz: how often the host asks for speed and fault; an answer that is late makes it ask later.
        ramp_rpm_per_s: of the rotor. The host makes the ramp.
        brake_A: motor current of a stop, and of the hold at speed 0.
        min_erpm: electrical speed below which the controller cannot hold a speed; the firmware's own default, not
            verified on a motor. The ramp leaves out what lies below.
        rest_rpm: its reading of a standing rotor may be up to this.
        follow_s: how long the rotor may turn at another speed than the set-point before it counts as not following.
    """

    baud: Annotated[int, Field(ge=9600, le=2_000_000)] = 115_200
    pole_pairs: Annotated[int, Field(ge=1, le=100)]
    timeout_s: Annotated[float, Field(ge=0.1, le=2.0)]
    command_ms: Annotated[int, Field(ge=10, le=200)] = 50
    report_Hz: Annotated[float, Field(ge=10, le=200)] = 50.0
    ramp_rpm_per_s: Annotated[float, Field(gt=0, le=1000)] = 120.0
    brake_A: Annotated[float, Field(gt=0, le=200)]
    min_erpm: Annotated[float, Field(ge=0, le=20_000)] = 900.0
    rest_rpm: Annotated[float, Field(ge=AT_REST_RPM, le=10)] = AT_REST_RPM
    follow_s: Positive = 3.0

    def roles(self, device: str) -> tuple[Role, ...]:
        """See DeviceSettings."""
        return (SpeedSource(device=device, topic="motor", ramp_rpm_per_s=self.ramp_rpm_per_s, rest_rpm=self.rest_rpm),)

    @model_validator(mode="after")
    def _commands_before_timeout(self) -> Vesc:
        if self.timeout_s * 1e3 < _COMMANDS_IN_TIMEOUT * self.command_ms:
            raise ValueError(
                f"timeout_s must be at least {_COMMANDS_IN_TIMEOUT} × command_ms, or a late command stops the rig: "
                f"got {self.timeout_s:g} s and {self.command_ms} ms"
            )
        return self

    @model_validator(mode="after")
    def _line_carries_reports(self) -> Vesc:
        taken = 10 * (_POLL_BYTES * self.report_Hz + _COMMAND_BYTES * 1e3 / self.command_ms)  # bits, start to stop
        if taken > _LINE_SHARE * self.baud:
            raise ValueError(
                f"report_Hz = {self.report_Hz:g} needs {taken:.0f} of the line's {self.baud} bit/s, more than "
                f"{_LINE_SHARE:.0%}: ask less often or raise baud, here and in the controller"
            )
        return self

    @property
    def min_rpm(self) -> float:
        """Least speed of the rotor that the controller holds, rpm."""
        return self.min_erpm / self.pole_pairs
