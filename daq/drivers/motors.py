"""What devices that turn the rotor have in common: their settings, the load of their line, and their samples."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import override

from daq import channels
from daq.drivers.contract import Pipeline
from daq.items import Batch, DeviceEvent
from rig_configs.device import DeviceSettings
from rig_configs.roles import AT_REST_RPM, Role, SpeedSource
from rig_configs.table import Positive

MOST_REST_RPM = 10.0
"""Largest reading that a rig file may count as rest, rpm."""
_MIN_COMMANDS = 4
"""Commands of the host within a controller's timeout, so that late ones do not stop the rig."""
LINE_SHARE, BUS_SHARE = 0.8, 0.5
"""Largest share of the capacity that requests and answers may use: of a serial line in one direction, of a CAN bus."""


class MotorSettings(DeviceSettings):
    """Settings of a device that turns the rotor.

    Attributes:
        ramp_rpm_per_s: rate of the rotor's ramp, rpm/s.
        rest_rpm: largest reading of a standing rotor, rpm.
    """

    ramp_rpm_per_s: Annotated[float, Field(gt=0, le=1000)] = 120.0
    rest_rpm: Annotated[float, Field(ge=AT_REST_RPM, le=MOST_REST_RPM)] = AT_REST_RPM

    @override
    def roles(self, device: str) -> tuple[Role, ...]:
        return (SpeedSource(device=device, topic="motor", ramp_rpm_per_s=self.ramp_rpm_per_s, rest_rpm=self.rest_rpm),)


class RepeatedSettings(MotorSettings):
    """Settings of a controller without a ramp of its own; see `daq.drivers.repeated_command`.

    Attributes:
        command_ms: period at which the host repeats its command, ms.
        follow_s: time for which the speed may differ from the set-point before the rotor counts as not following, s.
    """

    command_ms: Annotated[int, Field(ge=5, le=200)] = 20
    follow_s: Positive = 3.0

    @abstractmethod
    def own_timeout(self) -> tuple[str, float]:
        """Return the timeout after which the controller stops driving the rotor: name of the setting, and s."""

    @model_validator(mode="after")
    def _commands_before_timeout(self) -> RepeatedSettings:
        name, timeout_s = self.own_timeout()
        if timeout_s * 1e3 < _MIN_COMMANDS * self.command_ms:
            raise ValueError(
                f"{name} must be at least {_MIN_COMMANDS} × command_ms, or a late command stops the rig: "
                f"got {timeout_s:g} s and {self.command_ms} ms"
            )
        return self


def check_load(what: str, needed: float, line: str, carried: float, share: float, remedy: str) -> None:
    """Compare the load of a line with what it carries.

    Args:
        what: what loads it, with its verb: "commands and reports need".
        needed, carried: load and capacity, bit/s.
        line: the line's name.
        share: share of the capacity that may be used.
        remedy: what to do about a larger load.

    Raises:
        ValueError: the load is too large.
    """
    if needed > share * carried:
        raise ValueError(f"{what} {needed:.0f} of the {line}'s {carried} bit/s, more than {share:.0%}: {remedy}")


class MotorPipeline(Pipeline):
    """Base class of pipelines of devices that turn the rotor, whose samples get the host's time: they have no clock."""

    def __init__(self, device: str, *kinds: str) -> None:
        super().__init__(device, *kinds)
        self._reported_state: str | None = None
        self._reported_fault = 0

    def samples(self, rows: Sequence[tuple[float, float, int]], host_ns: int) -> list[Batch | DeviceEvent]:
        """Return the samples of one read: rows of speed and set-point, rpm, and statusword; none without rows."""
        if not rows:
            return []
        speed_rpm, target_rpm, words = zip(*rows, strict=True)
        columns = {
            "speed_rpm": np.array(speed_rpm, float),
            "target_rpm": np.array(target_rpm, float),
            "statusword": np.array(words, np.uint32),
        }
        time_ns = np.full(len(rows), host_ns, np.int64)
        return [Batch(channels.MOTOR, time_ns, np.zeros(len(rows), np.uint32), columns)]

    def state_events(self, state: str, **facts: Any) -> list[DeviceEvent]:
        """Return the event of a reported state, if it is another one than that before."""
        before, self._reported_state = self._reported_state, state
        return [] if state == before else [DeviceEvent("drive", self._device, state, facts)]

    def fault_events(self, code: int, text: str) -> list[DeviceEvent]:
        """Return the event of a reported fault code, if it is another one than that before; 0: no fault."""
        before, self._reported_fault = self._reported_fault, code
        return [] if code == before else [DeviceEvent("emergency", self._device, text, {"error_code": code})]
