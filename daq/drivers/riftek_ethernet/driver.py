"""RIFTEK RF60x sensors on Ethernet as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from daq.drivers.contract import DeviceLine, Pipeline, Talk
from daq.drivers.identification import FoundDevice
from daq.drivers.plain import DisplacementDriver
from daq.drivers.riftek_ethernet.settings import RiftekEthernetLaser
from daq.drivers.simulated import FarEnd


class RiftekEthernet(DisplacementDriver):
    """See Driver."""

    name = "riftek_ethernet"
    settings = RiftekEthernetLaser
    count_wrap: int = 2**32
    example: ClassVar[Mapping[str, Any]] = {"axis": "x", "rate_Hz": 9400.0}
    claims: frozenset[str] = frozenset({"counts exactly"})

    def line(self, settings: RiftekEthernetLaser) -> DeviceLine:
        """See Driver. The line is a UDP port, which has no rate."""
        return DeviceLine(settings.port, 0)

    def pipeline(self, device: str, settings: RiftekEthernetLaser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.riftek_ethernet.stream import RiftekEthernetPipeline

        return RiftekEthernetPipeline(device, settings, self.channels(settings)[0], identity)

    def far_end(self, device: str, settings: RiftekEthernetLaser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.riftek_ethernet.far_end import SimulatedRiftekEthernet

        return SimulatedRiftekEthernet.of(device, settings, world)

    def open(self, device: str, settings: RiftekEthernetLaser, talk: Talk) -> dict[str, Any]:
        """See Driver; the sensor sends without a command, and its packets have its serial number."""
        return {"driver": self.name, "port": settings.port}

    def recognise(self, settings: RiftekEthernetLaser, data: bytes) -> FoundDevice | None:
        """See RecognisesBytes."""
        from daq.drivers.riftek_ethernet.identity import recognise

        return recognise(settings, data)


DRIVER = RiftekEthernet()
