# pyright: strict
"""CiA 402 drives as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.cia402 import wire
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.contract import Line, RotorGuard, SampleClock, Talk
from daq.drivers.items import Event
from daq.transports.host_clock import HostClock
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

    def words(self, event: Event) -> str:
        """See Driver."""
        code = int(event.facts["error_code"])
        return wire.emergency_words(code) if code else ""

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: Drive, talk: Talk) -> dict[str, Any]:
        """See Driver; the network is started by who holds the drive (`control`)."""
        return {"driver": self.name, "node_id": settings.node_id}

    def stop(self, talk: Talk) -> None:
        """See Driver; who holds the drive has stopped it (`control`)."""

    def speed_source(
        self, settings: Drive, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> DriveControl:
        """See TurnsRotor."""
        return DriveControl(settings, send, clock, guard)


DRIVER = Cia402()
