# pyright: strict
"""Packets of a VESC: start byte, length, payload, CRC-16/XMODEM of the payload, 03h.

The start byte says how wide the length is: 02h one byte, 03h two.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass, field

SHORT, LONG, END = 0x02, 0x03, 0x03
MAX_PAYLOAD = 512
"""Longest payload a controller sends or takes."""


def packet(payload: bytes) -> bytes:
    """A payload as it goes over the line.

    Raises:
        ValueError: empty, or longer than a controller takes.
    """
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"expected 1 to {MAX_PAYLOAD} bytes of payload, got {len(payload)}")
    head = struct.pack(">BB", SHORT, len(payload)) if len(payload) < 256 else struct.pack(">BH", LONG, len(payload))
    return head + payload + struct.pack(">HB", binascii.crc_hqx(payload, 0), END)


@dataclass(frozen=True)
class Found:
    """What some bytes completed.

    Attributes:
        payloads: of sound packets, in their order.
        skipped: bytes in no sound packet.
    """

    payloads: list[bytes] = field(default_factory=list[bytes])
    skipped: int = 0


class PacketDecoder:
    """Bytes to payloads.

    A packet is found with its last byte, whatever seemed to begin before it: after damage, a start byte that is none
    may claim a length that reaches over several answers, which are not to wait for it. Bytes in no sound packet are
    counted. Memory is bounded: what is kept is no longer than the longest packet.

    Args:
        forgiven: how many bytes before the first sound packet are not counted: the rest of one that began earlier.
    """

    def __init__(self, forgiven: int = 0) -> None:
        self._forgiven = forgiven
        self._have = bytearray()  # from the oldest byte that may begin a packet
        self._first = 0  # how many came before
        self._starts: dict[int, list[int]] = {}  # of what may be a packet, by where it would end

    def feed(self, data: bytes) -> Found:
        """Take bytes; any split of a stream gives the same payloads and the same count."""
        have, first, at = self._have, self._first, len(self._have)
        have += data
        payloads: list[bytes] = []
        free = skipped = 0  # where nothing is found yet
        for i in range(at, len(have)):
            self._begin(i, free)
            if (starts := self._starts.pop(first + i + 1, None)) is None or have[i] != END:
                continue
            for start in starts:
                payload = _sound(have[start - first : i + 1])
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
        """Note what may be a packet, its length having come with byte i."""
        have = self._have
        for head, start in ((SHORT, i - 1), (LONG, i - 2)):
            if start >= free and have[start] == head:
                length = int.from_bytes(have[start + 1 : i + 1], "big")
                if 0 < length <= MAX_PAYLOAD:
                    self._starts.setdefault(self._first + i + 1 + length + 3, []).append(self._first + start)

    def _oldest(self, free: int) -> int:
        """Where the oldest byte stands that may begin a packet."""
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


def _sound(data: bytearray) -> bytes | None:
    """The payload of a packet, its length as said and its end in place; None when its checksum is wrong."""
    payload = bytes(data[2 if data[0] == SHORT else 3 : -3])
    return payload if int.from_bytes(data[-3:-1], "big") == binascii.crc_hqx(payload, 0) else None
