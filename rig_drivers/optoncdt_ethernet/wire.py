"""Packets of an optoNCDT 2300 on Ethernet: a header and frames of 32-bit words, little-endian, over TCP.

- bytes 0 … 3: preamble 4D454153h (on the wire ``SAEM``)
- 4 … 7 order number, 8 … 11 serial number
- 12 … 19: two words of flags that name the values of a frame. Bits of the first word by the manual's figure: 2 SHUTTER,
  3 COUNTER, 4 TIMESTAMP, 5 TEMP, 8 INTENSITY, 16 STATE, 19 TRIGCNT
- 20 … 23: number of frames u16, bytes of a frame u16; the manual's figures disagree on their order: the one that fits
  `words` is taken
- 24 … 27: counter
- from 28: frames

What is not verified: docs/protocols/optoncdt_ethernet.md.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PREAMBLE = 0x4D454153
COUNTER_WRAP = 2**32
MOST_FRAME_BYTES = 32 * 4
MOST_FRAMES = 8192
_HEADER = struct.Struct("<IIIIIHHI")
HEADER_BYTES = _HEADER.size
_PREAMBLE_BYTES = PREAMBLE.to_bytes(4, "little")
_OWN_BYTES = 12  # of a header that are the same in every packet of a sensor: preamble, order and serial number

_VALUE_BITS = {
    "SHUTTER": 2,
    "COUNTER": 3,
    "TIMESTAMP": 4,
    "TEMP": 5,
    "INTENSITY": 8,
    "DIST": None,
    "STATE": 16,
    "TRIGCNT": 19,
}
"""Bits of the first word of flags, in the order of the values in a frame. The distance is always there."""


def flags_of(words: Collection[str]) -> tuple[int, int]:
    """Return the flags of packets whose frames have these values."""
    return sum(1 << bit for name, bit in _VALUE_BITS.items() if bit is not None and name in words), 0


def values_named(flags: tuple[int, int]) -> tuple[str, ...]:
    """Return the values of a frame that the flags of a packet name, in their order."""
    return tuple(name for name, bit in _VALUE_BITS.items() if bit is None or flags[0] >> bit & 1)


def contradicts(flags: tuple[int, int], words: Collection[str]) -> bool:
    """Whether the flags of a packet name other values than these; names that flags do not know are left out."""
    return {*values_named(flags)} != {*words} & _VALUE_BITS.keys()


class Misfit(NamedTuple):
    """Header of a packet whose frames have another size than the decoder's.

    Attributes:
        order, serial, flags: see Packet.
        sizes: number of frames and bytes of a frame, as received; the order may be the other one.
    """

    order: int
    serial: int
    flags: tuple[int, int]
    sizes: tuple[int, int]


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
    """Packets of one read.

    Attributes:
        packets: the packets.
        skipped_bytes: number of bytes between them that belong to none.
        misfits: headers whose frames have another size.
    """

    packets: list[Packet] = field(default_factory=list[Packet])
    skipped_bytes: int = 0
    misfits: list[Misfit] = field(default_factory=list[Misfit])


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
                found.misfits.append(Misfit(order, serial, (first, second), (a, b)))
                found.skipped_bytes += 1
                at += 1
                continue
            end = at + HEADER_BYTES + count * self._frame_bytes
            if (cut := self._cut(stream, at, end)) is not None:
                found.skipped_bytes += cut - at
                at = cut
                continue
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

    def _cut(self, stream: bytes, at: int, end: int) -> int | None:
        """Return the place of the next header of the same sensor within a packet; None if the packet has none."""
        own = stream[at : at + _OWN_BYTES]
        place = stream.find(own, at + HEADER_BYTES, end)
        if place >= 0:
            return place
        if end > len(stream):
            return None
        begun = (n for n in range(_OWN_BYTES - 1, len(_PREAMBLE_BYTES) - 1, -1) if stream.endswith(own[:n], at, end))
        return next((end - n for n in begun), None)


class FrameSize:
    """Finds the size of the frames of a sensor whose packets do not fit the rig file, from its headers.

    A preamble may occur by chance; `_CERTAIN` headers with the same order and serial number do not.
    """

    _CERTAIN = 4

    def __init__(self) -> None:
        self._own = (0, 0)
        self._headers = 0
        self._sizes: set[int] = set()

    def clear(self) -> None:
        """Discard the headers, since a packet fits."""
        self._headers = 0

    def feed(self, misfits: Iterable[Misfit]) -> int | None:
        """Take the next headers; return the size of a frame in bytes once it is certain, otherwise None.

        Of two possible sizes the second one is taken, as in the manual's figure of the header.
        """
        for header in misfits:
            if (header.order, header.serial) != self._own or not self._headers:
                self._own, self._headers, self._sizes = (header.order, header.serial), 0, {*header.sizes}
            self._headers += 1
            self._sizes = self._sizes & {*header.sizes} or {*header.sizes}
            if self._headers >= self._CERTAIN:
                return next((size for size in header.sizes[::-1] if size in self._sizes and size % 4 == 0 < size), None)
        return None
