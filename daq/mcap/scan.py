"""Records in a block of bytes as numpy arrays: their places, and fields at many places at once."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from daq.mcap.blocks import Runs, fields, times
from daq.mcap.open_chunk import INDEX_ENTRY_BYTES, INDEX_HEAD, MESSAGE_HEAD
from daq.mcap.records import RECORD_HEAD, DamageError

_EIGHT = struct.Struct("<Q")


def record_places(data: bytes | memoryview, kind: int = 0) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Find the whole records at the start of a block; successive ones of equal kind, length and channel together.

    Args:
        kind: opcode of the records; 0 for any.

    Returns:
        Offset and size of each, (n,), bytes, including opcode and length; and the offset of the rest.
    """
    runs, position, size = Runs(), 0, len(data)
    while size - position >= RECORD_HEAD.size:
        length = _EIGHT.unpack_from(data, position + 1)[0]
        end = position + RECORD_HEAD.size + length
        if end > size or not data[position] or data[position] != (kind or data[position]):
            break
        count = 1
        if length >= 2 and data[end : end + 11] == data[position : position + 11]:
            count = _alike(data, position, end - position)
        runs.add(position, count, end - position)
        position += count * (end - position)
    return *runs.places(), position


def _alike(data: bytes | memoryview, position: int, size: int) -> int:
    """Return the number of successive records of `size` bytes whose first 11 bytes equal those at `position`."""
    most, count, step = (len(data) - position) // size, 1, 1024
    first, second = (_EIGHT.unpack_from(data, position + part)[0] for part in (0, 3))
    while count < most:
        shape, start = min(step, most - count), position + count * size
        wrong = np.ndarray(shape, "<u8", data, start, (size,)) != first
        wrong |= np.ndarray(shape, "<u8", data, start + 3, (size,)) != second
        at = int(wrong.argmax())
        if wrong[at]:
            return count + at
        count, step = count + shape, 4 * step
    return count


@dataclass(frozen=True)
class Messages:
    """n messages in the records of a chunk.

    Attributes:
        data: the records.
        offsets, ends: int64 (n,), start and end of each message's record.
        channel_ids: uint16 (n,).
        log_ns, publish_ns: uint64 (n,), ns since 1970.
    """

    data: bytes | memoryview
    offsets: NDArray[np.int64]
    ends: NDArray[np.int64]
    channel_ids: NDArray[np.uint16]
    log_ns: NDArray[np.uint64]
    publish_ns: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.offsets)

    def payload(self, row: int) -> bytes:
        """Return the message of a row."""
        return bytes(self.data[self.offsets[row] + MESSAGE_HEAD.size : self.ends[row]])

    def part(self, rows: NDArray[np.bool_]) -> Messages:
        """Return the selected rows."""
        places, times = (self.offsets[rows], self.ends[rows]), (self.log_ns[rows], self.publish_ns[rows])
        return Messages(self.data, *places, self.channel_ids[rows], *times)

    @property
    def sequences(self) -> NDArray[np.uint32]:
        """Sequence numbers (n,)."""
        return fields(self.data, self.offsets + 11, "<u4")

    @cached_property
    def counts(self) -> dict[int, int]:
        """Number of messages by channel id."""
        numbers = np.bincount(self.channel_ids)
        return {channel_id: int(numbers[channel_id]) for channel_id in np.flatnonzero(numbers).tolist()}

    def indexes(self) -> bytes:
        """Return their message indexes: one for each channel, in the order of its id, entries in order of log time."""
        entries = np.stack([self.log_ns, self.offsets.astype(np.uint64)], axis=1)
        data, at = entries[np.lexsort((self.log_ns, self.channel_ids))].tobytes(), 0
        parts: list[bytes] = []
        for channel_id, count in self.counts.items():
            end = at + INDEX_ENTRY_BYTES * count
            parts += [INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + end - at, channel_id, end - at), data[at:end]]
            at = end
        return b"".join(parts)

    def span(self) -> tuple[int, int]:
        """Return first and last log time, ns; zeros without messages."""
        return (int(self.log_ns.min()), int(self.log_ns.max())) if len(self) else (0, 0)


def messages_at(data: bytes | memoryview, offsets: NDArray[np.int64], ends: NDArray[np.int64]) -> Messages:
    """Return the messages whose records are at `offsets`."""
    return Messages(data, offsets, ends, fields(data, offsets + 9, "<u2"), *times(data, offsets))


def split_chunk(data: bytes | memoryview) -> tuple[Messages, list[tuple[int, bytes]]]:
    """Return the messages of an unpacked chunk, and opcode and content of its schemas and channels.

    Raises:
        DamageError: it does not consist of whole records.
    """
    offsets, sizes, end = record_places(data)
    opcodes = fields(data, offsets, "u1")
    is_message = opcodes == Opcode.MESSAGE
    if end != len(data) or (sizes[is_message] < MESSAGE_HEAD.size).any():
        raise DamageError("a chunk that does not consist of whole records")
    defining = np.flatnonzero((opcodes == Opcode.SCHEMA) | (opcodes == Opcode.CHANNEL))
    rows = slice(None) if is_message.all() else is_message
    places: list[tuple[int, int]] = list(zip(offsets[defining].tolist(), sizes[defining].tolist(), strict=True))
    definitions = [(int(data[at]), bytes(data[at + RECORD_HEAD.size : at + size])) for at, size in places]
    return messages_at(data, offsets[rows], (offsets + sizes)[rows]), definitions
