"""Packets of a VESC: start byte, length, payload, CRC-16/XMODEM of the payload, 03h.

The start byte determines the width of the length: one byte after 02h, two bytes after 03h (from 256 bytes on). Numbers
are big-endian. CRC: polynomial 1021h, start 0; "123456789" gives 31C3h [S, M]. Payloads have 1 to 512 bytes [U]. Query
of values: ``02 01 04 40 84 03``; hold 3000 electrical rpm: ``02 05 08 00 00 0B B8 F8 04 03`` [M].
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass

SHORT, LONG, END = 0x02, 0x03, 0x03
MAX_PAYLOAD = 512
"""Longest payload that a controller sends or accepts, bytes."""


def packet(payload: bytes) -> bytes:
    """Encode a payload for the line.

    Raises:
        ValueError: the payload is empty, or longer than a controller accepts.
    """
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"expected 1 to {MAX_PAYLOAD} bytes of payload, got {len(payload)}")
    head = struct.pack(">BB", SHORT, len(payload)) if len(payload) < 256 else struct.pack(">BH", LONG, len(payload))
    return head + payload + struct.pack(">HB", binascii.crc_hqx(payload, 0), END)


@dataclass(frozen=True)
class Found:
    """Result of one call of `PacketDecoder.feed`.

    Attributes:
        payloads: payloads of intact packets, in order.
        skipped: number of bytes outside intact packets.
    """

    payloads: list[bytes]
    skipped: int


class PacketDecoder:
    """Decode bytes to payloads. The payloads and the count do not depend on the split into calls.

    A packet is found with its last byte, independent of possible packets that began earlier. After damage, a false
    start byte may be followed by a length that covers several answers; these answers do not wait for its end. Bytes
    outside intact packets are counted. Memory is bounded by the longest packet.

    Args:
        forgiven: number of bytes before the first intact packet that are not counted: the rest of an earlier packet.
    """

    def __init__(self, forgiven: int = 0) -> None:
        self._forgiven = forgiven
        self._have = bytearray()  # bytes from the oldest one that may begin a packet
        self._first = 0  # number of bytes before these
        self._starts: dict[int, list[int]] = {}  # positions of possible starts, by the position of their end

    def feed(self, data: bytes) -> Found:
        """Decode the next bytes of the line."""
        have, first, at = self._have, self._first, len(self._have)
        have += data
        payloads: list[bytes] = []
        free = skipped = 0  # `free`: end of the last packet
        for i in range(at, len(have)):
            self._begin(i, free)
            if (starts := self._starts.pop(first + i + 1, None)) is None or have[i] != END:
                continue
            for start in starts:
                payload = _payload(have[start - first : i + 1])
                if payload is not None:
                    payloads.append(payload)
                    skipped += self._charged(start - first - free)
                    free, self._forgiven = i + 1, 0
                    self._starts.clear()
                    break
        keep = self._oldest(free)
        skipped += self._charged(keep - free)
        del have[:keep]
        self._first += keep
        return Found(payloads, skipped)

    def _begin(self, i: int, free: int) -> None:
        """Store the possible packets whose length ends with byte i."""
        have = self._have
        for head, start in ((SHORT, i - 1), (LONG, i - 2)):
            if start >= free and have[start] == head:
                length = int.from_bytes(have[start + 1 : i + 1], "big")
                if 0 < length <= MAX_PAYLOAD:
                    self._starts.setdefault(self._first + i + 1 + length + 3, []).append(self._first + start)

    def _oldest(self, free: int) -> int:
        """Return the position of the oldest byte that may begin a packet."""
        have, end = self._have, len(self._have)
        oldest = min((start for starts in self._starts.values() for start in starts), default=self._first + end)
        oldest -= self._first
        if end > free + 1 and have[-2] == LONG:
            return min(oldest, end - 2)
        return min(oldest, end - 1) if end > free and have[-1] in (SHORT, LONG) else oldest

    def _charged(self, skipped: int) -> int:
        forgiven = min(skipped, self._forgiven)
        self._forgiven -= forgiven
        return skipped - forgiven


def _payload(data: bytearray) -> bytes | None:
    """Return the payload of a packet of correct length and end; None if its checksum is wrong."""
    payload = bytes(data[2 if data[0] == SHORT else 3 : -3])
    return payload if int.from_bytes(data[-3:-1], "big") == binascii.crc_hqx(payload, 0) else None
