"""optoNCDT 2300 sensors on Ethernet as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import DeviceLine, Pipeline, SpeedControl, Talk
from daq.drivers.identification import FoundDevice
from daq.drivers.optoncdt_ethernet.settings import EthernetLaser
from daq.drivers.plain import DisplacementDriver
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent


class EthernetDriver(DisplacementDriver):
    """See Driver."""

    name = "optoncdt_ethernet"
    settings = EthernetLaser
    count_wrap: int = 2**32
    example: ClassVar[Mapping[str, Any]] = {"axis": "x"}
    claims: frozenset[str] = frozenset({"counts exactly"})

    def line(self, settings: EthernetLaser) -> DeviceLine:
        """See Driver. The line is a TCP connection, which has no rate."""
        return DeviceLine(settings.port, 0)

    def pipeline(self, device: str, settings: EthernetLaser, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.optoncdt_ethernet.stream import EthernetPipeline

        (channel,) = self.channels(settings)
        return EthernetPipeline(device, settings, channel, identity)

    def far_end(self, device: str, settings: EthernetLaser, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.optoncdt_ethernet.far_end import SimulatedEthernetLaser

        return SimulatedEthernetLaser.of(device, settings, world)

    def checks(
        self, settings: EthernetLaser, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the values that the flags of the packets name, and the reason why samples are not taken."""
        expected = ", ".join(settings.words)
        doubt, complaint = str(pipeline.doubt), str(pipeline.complaint)
        return {
            "values": DeviceCheck("others" if doubt else expected, expected, not doubt, doubt),
            "packets": DeviceCheck("differ" if complaint else "fit", "fit", not complaint, complaint),
        }

    def open(self, device: str, settings: EthernetLaser, talk: Talk) -> dict[str, Any]:
        """See Driver; the sensor sends as soon as it is connected, and its packets have its serial number."""
        return {"driver": self.name, "port": settings.port}

    def recognise(self, settings: EthernetLaser, data: bytes) -> FoundDevice | None:
        """See RecognisesBytes."""
        from daq.drivers.optoncdt_ethernet.identity import recognise

        return recognise(settings, data)


DRIVER = EthernetDriver()
