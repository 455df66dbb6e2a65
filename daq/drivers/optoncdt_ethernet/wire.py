"""Packets of an optoNCDT 2300 on Ethernet: a header and frames of 32-bit words, little-endian, over TCP.

Source: docs/protocols/optoncdt_ethernet.md, which also states what is not verified.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

PREAMBLE = 0x4D454153
COUNTER_WRAP = 2**32
MOST_FRAME_BYTES = 32 * 4
MOST_FRAMES = 8192
_HEADER = struct.Struct("<IIIIIHHI")
HEADER_BYTES = _HEADER.size
_PREAMBLE_BYTES = PREAMBLE.to_bytes(4, "little")


@dataclass(frozen=True)
class Packet:
    """One packet.

    Attributes:
        order, serial: order number and serial number of the sensor.
        flags: both words of flags, which name the channels of a frame.
        counter: counter of the packet.
        frames: words of the frames, shape (n, words).
    """

    order: int
    serial: int
    flags: tuple[int, int]
    counter: int
    frames: NDArray[np.uint32]


@dataclass
class DecodedPackets:
    """Packets of one read, and the number of bytes between them that belong to none."""

    packets: list[Packet] = field(default_factory=list[Packet])
    skipped_bytes: int = 0


def encode(packet: Packet) -> bytes:
    """Encode a packet: the number of frames before the number of bytes of a frame."""
    count, words = packet.frames.shape
    head = _HEADER.pack(PREAMBLE, packet.order, packet.serial, *packet.flags, count, 4 * words, packet.counter)
    return head + packet.frames.astype("<u4").tobytes()


class PacketDecoder:
    """Decodes a stream to packets. The result does not depend on the split into reads; memory is bounded.

    Args:
        words: number of words of a frame. The manual's figures disagree on the order of the number of frames and the
            number of bytes of a frame; the order is the one that fits the words.
    """

    def __init__(self, words: int) -> None:
        self._frame_bytes = 4 * words
        self._rest = b""

    def feed(self, data: bytes) -> DecodedPackets:
        """Decode the next bytes."""
        stream, found, at = self._rest + data, DecodedPackets(), 0
        while True:
            start = stream.find(_PREAMBLE_BYTES, at)
            if start < 0:
                kept = next(n for n in (3, 2, 1, 0) if n == 0 or stream.endswith(_PREAMBLE_BYTES[:n]))
                start = max(at, len(stream) - kept)
            found.skipped_bytes += start - at
            at = start
            if len(stream) - at < HEADER_BYTES:
                break
            _, order, serial, first, second, a, b, counter = _HEADER.unpack_from(stream, at)
            count = self._frames(a, b)
            if count is None:
                found.skipped_bytes += 1
                at += 1
                continue
            end = at + HEADER_BYTES + count * self._frame_bytes
            if end > len(stream):
                break
            words = np.frombuffer(stream[at + HEADER_BYTES : end], "<u4").astype(np.uint32).reshape(count, -1)
            found.packets.append(Packet(order, serial, (first, second), counter, words))
            at = end
        self._rest = stream[at:]
        return found

    def _frames(self, a: int, b: int) -> int | None:
        """Return the number of frames of a packet; None if neither number is that of the bytes of a frame."""
        count = a if b == self._frame_bytes else b if a == self._frame_bytes else None
        return count if count is not None and 0 < count <= MOST_FRAMES else None
