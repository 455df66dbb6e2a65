"""Recognition of an optoNCDT 2300 on Ethernet by its packets, which contain its serial number. Nothing is sent."""

from __future__ import annotations

from daq.drivers.identification import FoundDevice
from daq.drivers.optoncdt_ethernet import wire
from daq.drivers.optoncdt_ethernet.settings import EthernetLaser


def recognise(settings: EthernetLaser, data: bytes) -> FoundDevice | None:
    """Return the serial number in the first packet with frames of the settings' words; see RecognisesBytes."""
    packets = wire.PacketDecoder(len(settings.words)).feed(data).packets
    if not packets:
        return None
    first = packets[0]
    return FoundDevice({"serial": first.serial}, {"order": first.order, "serial": first.serial})
