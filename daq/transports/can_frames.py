"""Frames of a CAN bus as bytes: what a link to a bus reads and writes, and what a log keeps, for every adapter.

Each frame is a record of 24 bytes, little-endian:

    0  "CAN"             mark: records are found again after damaged bytes
    3  length            number of data bytes, 0 … 8
    4  identifier        u32; bit 31: 29-bit identifier, bit 30: remote request, bit 29: message of the adapter
    8  data              8 bytes, those beyond the length are 0
    16 time              i64, ns since 1970 as the adapter states it; 0: it states none

The bits of the identifier are those of Linux SocketCAN. A message of the adapter is no frame of the bus: an error frame
of SocketCAN, or one of `AdapterMessage`, with its number in the data (u64). In logs the frames of both directions have
this form.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of

EXTENDED, REMOTE, OF_ADAPTER = 1 << 31, 1 << 30, 1 << 29
"""Bits of the identifier in a record."""

RECORD_BYTES = 24
"""Length of a record."""
_RECORD = struct.Struct("<3sBI8sq")
_MARK = b"CAN"
_WHOLE = re.compile(_MARK + rb"[\x00-\x08].{20}", re.DOTALL)
_ROW = np.dtype([("mark", "S3"), ("length", "u1"), ("identifier", "<u4"), ("data", "u1", 8), ("time_ns", "<i8")])


class AdapterMessage(IntEnum):
    """Messages between a host and its adapter; identifiers behind those of SocketCAN's error frames.

    OPEN, CLOSE: the host opens the bus, at the bit rate in the data, bit/s, or closes it. OPENED, OPEN_REFUSED: the
    adapter's answers. REFUSED: number of frames that it did not send. DAMAGED: number of damaged lines of its text.
    """

    OPEN = 0x1F00_0001
    CLOSE = 0x1F00_0002
    OPENED = 0x1F00_0003
    OPEN_REFUSED = 0x1F00_0004
    REFUSED = 0x1F00_0005
    DAMAGED = 0x1F00_0006


_ADAPTER_MESSAGES = frozenset(AdapterMessage)


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One classic CAN frame.

    Attributes:
        arbitration_id: identifier of 11 bits, or of 29 bits if `extended`.
        data: 0 … 8 bytes; for a remote request as many zeros as bytes are requested.
        extended: whether the identifier has 29 bits.
        remote: whether the frame is a request for data.
        time_ns: time of the adapter, ns since 1970; 0: none. Frames with different times are equal.
    """

    arbitration_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    time_ns: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Decoded:
    """Result of one call of `FrameDecoder.feed`.

    Attributes:
        records: all records in order.
        damaged: number of places with bytes that are no records.
    """

    records: bytes
    damaged: int

    @property
    def rows(self) -> NDArray[Any]:
        """The records as a structured array (n,) with the fields length, identifier, data (n, 8), time_ns."""
        return np.frombuffer(self.records, _ROW)

    @property
    def is_of_bus(self) -> NDArray[np.bool_]:
        """Which rows are frames of the bus, shape (n,); the others are messages of the adapter."""
        return self.rows["identifier"] & OF_ADAPTER == 0

    @property
    def frames(self) -> list[CanFrame]:
        """Frames of the bus in order."""
        return [each for each in self.messages if isinstance(each, CanFrame)]

    @property
    def of_adapter(self) -> list[tuple[AdapterMessage, int]]:
        """Messages of the adapter and their numbers in order, without SocketCAN's error frames."""
        return [each for each in self.messages if not isinstance(each, CanFrame)]

    @cached_property
    def messages(self) -> list[CanFrame | tuple[AdapterMessage, int]]:
        """`frames` and `of_adapter` in their common order."""
        out: list[CanFrame | tuple[AdapterMessage, int]] = []
        for _, length, identifier, data, time_ns in _RECORD.iter_unpack(self.records):
            number = identifier & OF_ADAPTER - 1
            if not identifier & OF_ADAPTER:
                extended, remote = bool(identifier & EXTENDED), bool(identifier & REMOTE)
                out.append(CanFrame(number, data[:length], extended, remote, time_ns))
            elif number in _ADAPTER_MESSAGES:
                out.append((AdapterMessage(number), int.from_bytes(data, "little")))
        return out


class FrameDecoder:
    """Decoder of records.

    The result does not depend on the split into calls. Memory is bounded. `feed` does not raise.
    """

    def __init__(self) -> None:
        self._tail = b""
        self._skipping = False  # whether the bytes before the tail were damaged, and counted

    def feed(self, data: bytes) -> Decoded:
        """Decode the next bytes, any number of them."""
        data = self._tail + data
        whole: list[bytes] = []
        end = damaged = 0
        for found in _WHOLE.finditer(data):
            damaged += found.start() > end and not self._skipping
            whole.append(found[0])
            end, self._skipping = found.end(), False
        self._tail = data[max(end, len(data) - RECORD_BYTES + 1) :]
        if len(data) - end >= RECORD_BYTES:
            damaged += not self._skipping
            self._skipping = True
        return Decoded(b"".join(whole), damaged)


def decode(data: bytes) -> Decoded:
    """Decode whole records."""
    return FrameDecoder().feed(data)


def encode(*frames: CanFrame) -> bytes:
    """Return the records of frames.

    Raises:
        ValueError: the identifier or the data do not fit a classic CAN frame.
    """
    return b"".join(map(_encoded, frames))


def _encoded(frame: CanFrame) -> bytes:
    limit = 0x1FFFFFFF if frame.extended else 0x7FF
    if not 0 <= frame.arbitration_id <= limit or len(frame.data) > 8:
        raise ValueError(
            f"expected an identifier up to {limit:#x} and up to 8 bytes, "
            f"got {frame.arbitration_id:#x} and {number_of(len(frame.data), 'byte')}"
        )
    identifier = frame.arbitration_id | EXTENDED * frame.extended | REMOTE * frame.remote
    return _RECORD.pack(_MARK, len(frame.data), identifier, frame.data, frame.time_ns)


def error_frame(identifier: int, data: bytes, time_ns: int) -> bytes:
    """Return the record of an error frame of SocketCAN, as it came."""
    return _RECORD.pack(_MARK, len(data), identifier & (OF_ADAPTER - 1) | OF_ADAPTER, data, time_ns)


def adapter_message(kind: AdapterMessage, number: int = 0) -> bytes:
    """Return the record of a message between host and adapter."""
    return _RECORD.pack(_MARK, 8, OF_ADAPTER | kind, number.to_bytes(8, "little"), 0)


def open_bus(bitrate: int) -> bytes:
    """Return the record by which a host opens the bus at a bit rate, bit/s; an open bus is closed first."""
    return adapter_message(AdapterMessage.OPEN, bitrate)


CLOSE_BUS = adapter_message(AdapterMessage.CLOSE)
"""Record by which a host closes the bus: the adapter sends nothing afterwards."""

_OPENING = open_bus(0)[:8]


def opens_bus(data: bytes) -> bool:
    """Return whether a host opens the bus by these records."""
    return _OPENING in data
