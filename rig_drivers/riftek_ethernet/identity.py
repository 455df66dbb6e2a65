"""Identification of a sensor by its bytes: recognition of one on a port, and words for packets that are not decoded."""

from __future__ import annotations

import numpy as np

from daq.drivers.identification import FoundDevice
from rig_basics.texts import number_of
from rig_drivers.riftek.wire import FULL_SCALE
from rig_drivers.riftek_ethernet import wire
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser

_MOST_MM = 5000  # of a range, and of the distance to its begin
_LEAST_SHARE = 0.9  # of results within full scale, in a packet
_RESULT_BYTES, _TAIL_BYTES = 3, 8


def recognise(settings: RiftekEthernetLaser, data: bytes) -> FoundDevice | None:
    """Return the sensor of the first two consecutive packets, or of the only one; see `Driver.recognise`."""
    if len(data) == wire.PACKET_BYTES and _is_plausible(only := wire.parse(data)):
        return _found(only)
    for at in range(min(wire.PACKET_BYTES, len(data) - 2 * wire.PACKET_BYTES + 1)):
        middle = at + wire.PACKET_BYTES
        if data[middle - _TAIL_BYTES : middle - 2] != data[middle - _TAIL_BYTES + wire.PACKET_BYTES :][:6]:
            continue
        first, second = wire.parse(data[at:middle]), wire.parse(data[middle : middle + wire.PACKET_BYTES])
        if second.number == (first.number + 1) % wire.NUMBERS and _is_plausible(first) and _is_plausible(second):
            return _found(first)
    return None


def _found(packet: wire.Packet) -> FoundDevice:
    facts = {"serial": packet.serial, "base_mm": packet.base_mm, "range_mm": packet.range_mm}
    return FoundDevice({"range_m": packet.range_mm / 1000, "serial": str(packet.serial)}, facts)


def words_for(data: bytes, range_mm: int, check: wire.Check) -> str:
    """Return what the bytes of a read are that contain no packet of the sensor; empty if they are not recognised.

    Args:
        data: the bytes, one datagram or several.
        range_mm: range of the expected sensor, mm.
        check: the expected check.
    """
    if len(data) < wire.PACKET_BYTES:
        results, tail = divmod(len(data) - _TAIL_BYTES, _RESULT_BYTES)
        if results > 0 and not tail and int.from_bytes(data[-4:-2], "little") == range_mm:
            return f"a packet of {number_of(results, 'result')}: set the sensor to {wire.RESULTS} in a packet"
        return ""
    last = data[-wire.PACKET_BYTES :]
    packet = wire.parse(last)
    if len(data) % wire.PACKET_BYTES or not _is_plausible(packet):
        return ""
    sensor = f"a packet of sensor {packet.serial}"
    if packet.range_mm != range_mm:
        return f"{sensor} with a range of {packet.range_mm} mm"
    if check != "none" and wire.check_of(last[:-1], check) != last[-1]:
        others: tuple[wire.Check, ...] = ("sum", "xor")
        fits = [kind for kind in others if wire.check_of(last[:-1], kind) == last[-1]]
        return f'{sensor} whose last byte is not that of checksum = "{check}"' + (
            f', but of checksum = "{fits[0]}"' if fits else ""
        )
    return f"{sensor}, {packet.base_mm} mm from the begin of its range"


def _is_plausible(packet: wire.Packet) -> bool:
    """Return whether bytes are a packet of any sensor: random results are rarely within full scale."""
    within = np.count_nonzero(packet.codes <= FULL_SCALE) >= _LEAST_SHARE * wire.RESULTS
    return bool(within) and 1 <= packet.range_mm <= _MOST_MM and packet.base_mm <= _MOST_MM
