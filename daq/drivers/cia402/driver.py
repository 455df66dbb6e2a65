# pyright: strict
"""CiA 402 drives as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.contract import Line, SampleClock, Talk
from rig_configs.schema import Drive

_ADAPTER_BAUD = 115_200  # of the adapter's own serial port, where it has one


class Cia402:
    """See Driver."""

    name = "cia402"
    rest_s = 0.01

    def line(self, settings: Drive) -> Line:
        """See Driver."""
        return Line(settings.port, _ADAPTER_BAUD, settings.bitrate)

    def channels(self, settings: Drive) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def clocks(self, settings: Drive) -> tuple[SampleClock, ...]:
        """See Driver; a drive has no clock, the host's time counts."""
        return ()

    def pipeline(self, device: str, settings: Drive, identity: Mapping[str, Any]) -> DrivePipeline:
        """See Driver."""
        return DrivePipeline(device, settings)

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: Drive, talk: Talk) -> dict[str, Any]:
        """See Driver; the network is started by who holds the drive (`control`)."""
        return {"driver": self.name, "node_id": settings.node_id}

    def stop(self, talk: Talk) -> None:
        """See Driver; who holds the drive has stopped it (`control`)."""


DRIVER = Cia402()
