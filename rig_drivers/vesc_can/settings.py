"""Settings of a VESC motor controller on a CAN bus in a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.drivers.motors import BUS_SHARE, check_load
from rig_drivers.vesc.settings import VescMotor

_FRAME_BITS = 160  # a frame of 8 data bytes with an identifier of 29 bits and every stuffed bit
_POLL_FRAMES = 14  # a poll, its answer in pieces, and a ping


class VescCan(VescMotor):
    """The VESC motor controller on a CAN bus behind an slcan adapter.

    Attributes:
        bitrate: bit rate of the bus, bit/s.
        controller_id: number of the controller on the bus.
        host_id: number under which the controller answers this host; no other node may have it.
        status_Hz: rate at which the controller sends its status by itself, Hz; 0: it sends none.
    """

    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 500_000
    controller_id: Annotated[int, Field(ge=0, le=253)]
    host_id: Annotated[int, Field(ge=0, le=253)] = 253
    status_Hz: Annotated[float, Field(ge=0, le=500)] = 50.0

    @model_validator(mode="after")
    def _numbers_differ(self) -> VescCan:
        if self.host_id == self.controller_id:
            raise ValueError(f"host_id and controller_id are both {self.host_id}, expected two numbers")
        return self

    @model_validator(mode="after")
    def _bus_carries_reports(self) -> VescCan:
        needed = _FRAME_BITS * (_POLL_FRAMES * self.report_Hz + 1e3 / self.command_ms + self.status_Hz)
        remedy = "reduce report_Hz or status_Hz, or raise bitrate"
        check_load("commands and reports need", needed, "bus", self.bitrate, BUS_SHARE, remedy)
        return self
