"""Search for the base station's packets in the bytes of its serial line.

Answers of a base station or node, as text in the replies of a dialogue, and the beacon's time in such an answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from rig_drivers.microstrain import wire
from rig_drivers.microstrain.wire import LAYOUTS, MAX_PAYLOAD, Packet, Version, packet_of

_MAX_FLAGS = 0x0F  # the high half of the flags is 0 in every packet


@dataclass(frozen=True)
class Line:
    """Result of one call of `PacketSearch.feed`.

    Attributes:
        packets: intact packets, in order.
        skipped_bytes: number of bytes that belong to no packet.
    """

    packets: list[Packet]
    skipped_bytes: int


class PacketSearch:
    """Decodes bytes to packets. Packets and number of skipped bytes do not depend on the split into calls.

    A start without an intact packet is skipped alone, so a damaged length affects only its own packet. Memory is
    bounded by the longest packet. Up to the length of one packet before the first one is not counted: it began earlier.
    A single start before another one is the confirmation by which a base station of version 1 reports that it has sent
    a request to a node; it does not count either.

    Args:
        version: version of the packets; those of another version are not decoded.
    """

    def __init__(self, version: Version) -> None:
        self._version: Version = version
        self._layout = LAYOUTS[version]
        self._confirmed = bytes((self._layout.start,)) * 2 if version == 1 else None
        self._line = bytearray()
        self._excused = self._layout.head + MAX_PAYLOAD + self._layout.tail

    def feed(self, data: bytes) -> Line:
        """Decode the next bytes of the line."""
        self._line += data
        packets: list[Packet] = []
        skipped = 0
        while self._line:
            start = self._line.find(self._layout.start)
            skipped += self._skip(len(self._line) if start < 0 else start)
            length = self._length()
            if length is None:
                break
            packet = packet_of(bytes(self._line[:length]), self._version) if length else None
            if packet is None:
                is_confirmation = bytes(self._line[:2]) == self._confirmed
                counted = self._skip(1)
                skipped += 0 if is_confirmation else counted
                continue
            packets.append(packet)
            del self._line[:length]
            self._excused = 0
        return Line(packets, skipped)

    def _length(self) -> int | None:
        """Return the length of the packet that begins here; 0: none begins here, None: it is incomplete."""
        line, head = self._line, self._layout.head
        if len(line) > 1 and line[1] > _MAX_FLAGS:
            return 0
        if len(line) < head:
            return None
        payload = line[5] if self._version == 1 else int.from_bytes(line[7:9], "big")
        length = head + payload + self._layout.tail
        if payload > MAX_PAYLOAD:
            return 0
        return length if len(line) >= length else None

    def _skip(self, count: int) -> int:
        """Remove bytes; return the number that counts as skipped."""
        del self._line[:count]
        excused = min(count, self._excused)
        self._excused -= excused
        return count - excused


_BEACON_BYTES = 11


@dataclass(frozen=True)
class Answer:
    """One answer.

    Attributes:
        kind: type of its packet.
        address: sender.
        payload: its content; it begins with the number of the command.
        host_ns: host time of its arrival, ns since 1970.
    """

    kind: int
    address: int
    payload: bytes
    host_ns: int

    @property
    def text(self) -> str:
        """The answer as text; see `of_text`."""
        return f"{self.kind} {self.address} {self.host_ns} {self.payload.hex()}"

    @classmethod
    def of_text(cls, text: str) -> Answer:
        """Return the answer of a text.

        Raises:
            ValueError: the text is not that of an answer.
        """
        kind, address, host_ns, payload = text.split(" ")
        return cls(int(kind), int(address), bytes.fromhex(payload), int(host_ns))

    @property
    def command(self) -> int:
        """Number of the command that is answered."""
        return int.from_bytes(self.payload[:2], "big")


class Beacon(NamedTuple):
    """State of the beacon.

    Attributes:
        is_on: whether the base station sends it.
        time_ns: its time, ns since 1970.
    """

    is_on: bool
    time_ns: int


def beacon_of(packet: wire.Packet | Answer) -> Beacon | None:
    """Return the beacon's state in an answer to BEACON_STATUS; None for any other packet."""
    data = packet.payload
    if packet.kind != wire.BASE_SUCCESS or len(data) != _BEACON_BYTES:
        return None
    if int.from_bytes(data[:2], "big") != wire.BEACON_STATUS:
        return None
    return Beacon(data[2] == 1, int.from_bytes(data[3:7], "big") * 10**9 + int.from_bytes(data[7:11], "big"))
