"""Packets of an RF60x sensor on Ethernet: 512 bytes, little-endian, without a start mark.

168 results, each u16 and a status u8; serial number u16, distance to the begin of the range u16 (mm), range u16 (mm),
number of the packet u8 (modulo 256), check u8. A datagram is one packet. A result D is the distance D · range / 16384
from the begin of the range. A packet is recognised by the range of the rig file, after damage by the whole identity.
All other bytes are counted (`bytes`). If they are an RF60x packet, the event (before the first packet the error) states
what differs: range, serial number, check, number of results.

Source: the maker's open library (RIFTEK-LLC/RF60XSDK). Unverified: the algorithm of the check, the meaning of a status.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Check = Literal["none", "sum", "xor"]

RESULTS = 168
"""Number of results in a packet."""
NUMBERS = 256
"""Packets are numbered modulo this."""
_PACKET = np.dtype(
    [
        ("results", [("code", "<u2"), ("status", "u1")], (RESULTS,)),
        ("serial", "<u2"),
        ("base_mm", "<u2"),
        ("range_mm", "<u2"),
        ("number", "u1"),
        ("check", "u1"),
    ]
)
PACKET_BYTES = _PACKET.itemsize
_RANGE_AT = PACKET_BYTES - 4


@dataclass(frozen=True)
class Packet:
    """One packet.

    Attributes:
        serial: serial number of the sensor.
        base_mm, range_mm: distance to the begin of the measuring range, and the range, mm.
        number: number of the packet, modulo NUMBERS.
        codes, status: results and their status, shape (RESULTS,).
    """

    serial: int
    base_mm: int
    range_mm: int
    number: int
    codes: NDArray[np.int64]
    status: NDArray[np.int64]

    @property
    def sensor(self) -> tuple[int, int, int]:
        """The part that is the same in all packets of a sensor."""
        return self.serial, self.base_mm, self.range_mm


@dataclass
class DecodedPackets:
    """Packets of one read, and the number of bytes between them that belong to none."""

    packets: list[Packet] = field(default_factory=list[Packet])
    skipped_bytes: int = 0


def check_of(data: bytes, kind: Check) -> int:
    """Return the check of the bytes before it; 0 without a check."""
    if kind == "sum":
        return sum(data) & 0xFF
    return int(np.bitwise_xor.reduce(np.frombuffer(data, np.uint8))) if kind == "xor" else 0


def parse(data: bytes) -> Packet:
    """Parse the bytes of a packet; any PACKET_BYTES bytes are one."""
    row: Any = np.frombuffer(data, _PACKET)[0]
    codes, status = (row["results"][name].astype(np.int64) for name in ("code", "status"))
    return Packet(int(row["serial"]), int(row["base_mm"]), int(row["range_mm"]), int(row["number"]), codes, status)


class PacketDecoder:
    """Decodes a stream to packets. The result does not depend on the split into reads; memory is bounded.

    A packet has no start mark. It is recognised by the range, and by the whole identity of the sensor. The packets of
    another sensor are recognised from the second one that follows directly.

    Args:
        range_mm: measuring range of the sensor, mm.
        check: what the check is; packets whose check is wrong are skipped.
        serial: serial number of the first sensor, whose packets are still recognised at once when those of another one
            were; 0: that of the first packet.
    """

    def __init__(self, range_mm: int, check: Check, *, serial: int = 0) -> None:
        self._range_mm = range_mm
        self._check: Check = check
        self._rest = b""
        self._before = 0  # number of bytes before these
        self._serial = serial
        self._first: tuple[int, int, int] | None = None
        self._sensor: tuple[int, int, int] | None = None
        self._others: dict[int, tuple[int, int, int]] = {}  # identities of possible other sensors, by position

    def feed(self, data: bytes) -> DecodedPackets:
        """Decode the next bytes."""
        stream, found, at = self._rest + data, DecodedPackets(), 0
        while len(stream) - at >= PACKET_BYTES:
            start = self._start(stream, at)
            found.skipped_bytes += start - at
            at = start
            if len(stream) - at < PACKET_BYTES:
                break
            packet = self._packet(stream[at : at + PACKET_BYTES], self._before + at)
            if packet is None:
                found.skipped_bytes += 1
                at += 1
                continue
            found.packets.append(packet)
            self._sensor = packet.sensor
            if self._first is None and packet.serial == (self._serial or packet.serial):
                self._first = packet.sensor
            self._others.clear()
            at += PACKET_BYTES
        self._rest = stream[at:]
        self._before += at
        return found

    def _start(self, stream: bytes, at: int) -> int:
        """Return the next place at which a packet with the sensor's range may begin."""
        place = stream.find(self._range_mm.to_bytes(2, "little"), at + _RANGE_AT)
        return max(at, len(stream) - PACKET_BYTES + 1) if place < 0 else place - _RANGE_AT

    def _packet(self, data: bytes, position: int) -> Packet | None:
        if self._check != "none" and check_of(data[:-1], self._check) != data[-1]:
            return None
        packet = parse(data)
        if packet.sensor == self._sensor or self._others.get(position - PACKET_BYTES) == packet.sensor:
            return packet
        is_first = 0 < self._serial == packet.serial if self._first is None else packet.sensor == self._first
        if is_first:
            return packet
        if self._sensor is None and position == 0:
            return packet
        self._others = {at: known for at, known in self._others.items() if at > position - PACKET_BYTES}
        self._others[position] = packet.sensor
        return None
