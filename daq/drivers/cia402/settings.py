"""Settings of a CiA 402 drive in a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.drivers.motors import MotorSettings
from rig_configs.table import Positive


class MotorDrive(MotorSettings):
    """The CiA 402 motor drive behind a CAN adapter.

    Attributes:
        bitrate: bit rate of the CAN bus, bit/s.
        node_id: CANopen node number of the drive.
        host_node_id: CANopen node number of the host.
        heartbeat_ms: period of the heartbeats of host and drive, ms.
        heartbeat_timeout_ms: time without the host's heartbeat after which the drive stops, ms.
        mode: mode of operation: "velocity" (vl, 6042h in rpm) or "profile velocity" (pv, 60FFh in a unit of the drive).
        units_per_rpm: of profile velocity mode: number of the drive's units of speed (60FFh, 606Ch) for 1 rpm. A wrong
            number scales every speed.
        ramp_units_per_rpm_per_s: of profile velocity mode: number of the units of 6083h and 6084h for 1 rpm/s; None:
            that of speeds.
        ramp_bits: whether bits 4 … 6 of the controlword are set during operation (007Fh in place of 000Fh), which some
            drives require.
    """

    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 500_000
    node_id: Annotated[int, Field(ge=1, le=127)] = 5
    host_node_id: Annotated[int, Field(ge=1, le=127)] = 1
    heartbeat_ms: Annotated[int, Field(ge=10, le=1000)] = 100
    heartbeat_timeout_ms: Annotated[int, Field(ge=50, le=800)] = 500
    mode: Literal["velocity", "profile velocity"] = "velocity"
    units_per_rpm: Positive = 1.0
    ramp_units_per_rpm_per_s: Positive | None = None
    ramp_bits: bool = False

    @model_validator(mode="after")
    def _beats_before_timeout(self) -> MotorDrive:
        if self.host_node_id == self.node_id:
            raise ValueError(f"host_node_id and node_id are both {self.node_id}: the drive would watch itself")
        if self.heartbeat_timeout_ms < 2 * self.heartbeat_ms:
            raise ValueError("heartbeat_timeout_ms must be at least twice heartbeat_ms, or one late beat stops the rig")
        if self.mode == "velocity" and (self.units_per_rpm != 1 or self.ramp_units_per_rpm_per_s is not None):
            raise ValueError('units_per_rpm and ramp_units_per_rpm_per_s belong to mode = "profile velocity"')
        if self.mode != "velocity" and self.ramp_bits:
            raise ValueError('ramp_bits belongs to mode = "velocity"')
        return self

    @property
    def ramp_units(self) -> float | None:
        """Units of 6083h and 6084h for 1 rpm/s; None in velocity mode."""
        return None if self.mode == "velocity" else self.ramp_units_per_rpm_per_s or self.units_per_rpm
