"""Recognition of an optoNCDT 2300 on Ethernet by its packets, which contain its serial number. Nothing is sent."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.identification import FoundDevice
from rig_drivers.optoncdt_ethernet import wire
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser


def recognise(settings: EthernetLaser, data: bytes) -> FoundDevice | None:
    """Return the serial number of the first packet, and the values of its frames; see `Driver.recognise`.

    The values are those of the settings if these fit the frames, otherwise those that the packet's flags name.
    """
    words = settings.words
    decoded = wire.PacketDecoder(len(words)).feed(data)
    if not decoded.packets and (words := _named_values(decoded.misfits)):
        decoded = wire.PacketDecoder(len(words)).feed(data)
    if not decoded.packets:
        return None
    first = decoded.packets[0]
    identity: dict[str, int] = {"order": first.order, "serial": first.serial}
    return FoundDevice({"serial": first.serial} | ({"words": list(words)} if len(words) > 1 else {}), identity)


def _named_values(misfits: Sequence[wire.Misfit]) -> tuple[str, ...]:
    """Return the values that the flags of the headers name, if the frames have so many, otherwise none."""
    size = wire.FrameSize().feed(misfits)
    words = wire.values_named(misfits[-1].flags) if misfits else ()
    return words if size == 4 * len(words) else ()
