"""Settings of a VESC motor controller in a rig file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from typing_extensions import override

from daq.drivers.motors import LINE_SHARE, RepeatedSettings, check_load

_POLL_BYTES = 6 + 80  # a poll and its answer with every field, framed
_COMMAND_BYTES = 10


class VescMotor(RepeatedSettings):
    """A VESC motor controller on any line.

    The values stored in the controller can neither be queried nor set by the host. They are therefore stated here,
    without defaults, because a wrong default would not be detected. `docs/protocols/vesc.md` describes how to measure
    them.

    Attributes:
        pole_pairs: number of pole pairs of the motor. The speed on the wire is electrical: pole_pairs times that of the
            rotor. With twice the true number the rotor turns at half the commanded speed.
        timeout_s: controller timeout, s, after which the controller removes the current of a motor that receives no
            command. Its documents state 0.5 s, its firmware 1 s: measure it.
        report_Hz: rate at which the host polls speed and fault, Hz; a late answer delays the next poll.
        brake_A: motor current of a stop and of the hold at speed 0, A.
        min_erpm: electrical speed below which the controller cannot hold a speed, rpm; default of the firmware, not
            verified on a motor. The ramp skips lower speeds.
    """

    pole_pairs: Annotated[int, Field(ge=1, le=100)]
    timeout_s: Annotated[float, Field(ge=0.1, le=2.0)]
    command_ms: Annotated[int, Field(ge=10, le=200)] = 50
    report_Hz: Annotated[float, Field(ge=10, le=200)] = 50.0
    brake_A: Annotated[float, Field(gt=0, le=200)]
    min_erpm: Annotated[float, Field(ge=0, le=20_000)] = 900.0

    @override
    def own_timeout(self) -> tuple[str, float]:
        return "timeout_s", self.timeout_s

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
        remedy = "reduce report_Hz or raise baud, here and in the controller"
        check_load(f"report_Hz = {self.report_Hz:g} needs", needed, "line", self.baud, LINE_SHARE, remedy)
        return self
