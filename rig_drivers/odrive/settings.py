"""Settings of an ODrive motor controller in a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from daq.drivers.motors import BUS_SHARE, RepeatedSettings, check_load

_FRAME_BITS = 135  # a frame of 8 data bytes with an identifier of 11 bits and every stuffed bit


class Odrive(RepeatedSettings):
    """One axis of an ODrive on a CAN bus behind an slcan adapter.

    The values stored in the controller cannot be queried on the bus of every firmware. Those that a wrong default would
    make dangerous have none. `docs/protocols/odrive.md` describes how to set and measure them.

    Attributes:
        bitrate: bit rate of the bus, bit/s.
        node_id: number of the axis on the bus.
        firmware: firmware of the controller; 0.5 and 0.6 differ in the commands 03h to 06h and in their error codes.
        serial: serial number of the controller, 12 hexadecimal digits, if it must be this one; firmware 0.6 only.
        gear_ratio: turns of the motor for one turn of the rotor; negative if they turn in opposite directions.
        watchdog_s: timeout of the controller's watchdog, s. Without it the controller continues without its host.
        proves_watchdog: whether the rotor is only driven after the watchdog of the idle controller has expired once;
            None: with firmware 0.5, whose watchdog is checked in every state (not verified for 0.6).
        heartbeat_ms, estimates_ms: periods of the controller's heartbeat and of its encoder estimates, ms, as set in
            the controller.
    """

    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 250_000
    node_id: Annotated[int, Field(ge=0, le=62)]
    firmware: Literal["0.5", "0.6"]
    serial: Annotated[str, Field(pattern=r"^([0-9A-F]{12})?$")] = ""
    gear_ratio: Annotated[float, Field(ge=-100, le=100)] = 1.0
    watchdog_s: Annotated[float, Field(ge=0.1, le=2.0)]
    proves_watchdog: bool | None = None
    heartbeat_ms: Annotated[int, Field(ge=5, le=200)] = 100
    estimates_ms: Annotated[int, Field(ge=1, le=100)] = 10

    @override
    def own_timeout(self) -> tuple[str, float]:
        return "watchdog_s", self.watchdog_s

    @field_validator("gear_ratio", mode="after")
    @classmethod
    def _turns(cls, ratio: float) -> float:
        if abs(ratio) < 0.01:
            raise ValueError(f"expected at least 0.01 turns of the motor for one of the rotor, got {ratio:g}")
        return ratio

    @model_validator(mode="after")
    def _serial_can_be_read(self) -> Odrive:
        if self.serial and self.firmware == "0.5":
            raise ValueError("serial: firmware 0.5 does not report it on the bus: omit it")
        return self

    @model_validator(mode="after")
    def _bus_carries_reports(self) -> Odrive:
        needed = _FRAME_BITS * 1e3 * (1 / self.command_ms + 1 / self.heartbeat_ms + 1 / self.estimates_ms)
        remedy = "raise estimates_ms, command_ms or bitrate"
        check_load("commands and reports need", needed, "bus", self.bitrate, BUS_SHARE, remedy)
        return self

    @property
    def needs_proof(self) -> bool:
        """Whether the watchdog must have expired before the rotor is driven."""
        return self.firmware == "0.5" if self.proves_watchdog is None else self.proves_watchdog

    def turns_per_s(self, rpm: float) -> float:
        """Return the speed of the motor, turns/s, at a speed of the rotor, rpm."""
        return rpm * self.gear_ratio / 60.0

    def rpm(self, turns_per_s: float) -> float:
        """Return the speed of the rotor, rpm, at a speed of the motor, turns/s."""
        return turns_per_s * 60.0 / self.gear_ratio
