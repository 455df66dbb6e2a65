"""Chunks of an MCAP file: their positions and contents; decompression within bounds and verification."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from daq.mcap.checksum import crc32
from daq.mcap.open_chunk import INDEX_ENTRY_BYTES, INDEX_HEAD
from daq.mcap.records import RECORD_HEAD, DamageError
from rig_basics.texts import number_of

CHUNK_LIMIT_BYTES = 64 * 2**20
"""Largest chunk that is unpacked; a head with a larger size is treated as damage."""
HEAD_BYTES = 4096
"""Number of bytes of a chunk record that contain its head."""
NEVER_NS, EVER_NS = -(2**63), 2**63 - 1
_HEAD = struct.Struct("<QQQII")
_per_thread = threading.local()


@dataclass(frozen=True)
class ChunkHead:
    """Fields of a chunk's head.

    Attributes:
        data_at: offset of the packed records from the record's start; 0 for messages in the file without a chunk.
        packed: their size, bytes.
    """

    start_ns: int
    end_ns: int
    unpacked: int
    crc: int
    compression: str
    data_at: int
    packed: int


def parse_head(record: bytes | memoryview, length: int) -> ChunkHead:
    """Parse the head of the chunk record that begins `record`.

    Args:
        record: first bytes of the record, 64 or more (fewer only if the record is shorter).
        length: length of the whole record including opcode and length field, bytes.

    Raises:
        DamageError: the lengths in it contradict each other.
    """
    at = RECORD_HEAD.size + _HEAD.size
    if length < at + 8 or len(record) < at:
        raise DamageError("a chunk whose lengths contradict each other")
    opcode, announced = RECORD_HEAD.unpack_from(record)
    start_ns, end_ns, unpacked, crc, name_bytes = _HEAD.unpack_from(record, RECORD_HEAD.size)
    data_at = at + name_bytes + 8
    if opcode != 6 or announced + RECORD_HEAD.size != length or data_at > min(length, len(record)):
        raise DamageError("a chunk whose lengths contradict each other")
    packed = int.from_bytes(record[data_at - 8 : data_at], "little")
    if data_at + packed > length:  # later versions of the format may append fields
        raise DamageError("a chunk whose lengths contradict each other")
    compression = bytes(record[at : at + name_bytes]).decode("ascii", "replace")
    return ChunkHead(start_ns, end_ns, unpacked, crc, compression, data_at, packed)


def unpack(packed: bytes | memoryview, head: ChunkHead, needs_crc: bool) -> bytes:
    """Decompress and verify the records of a chunk.

    Args:
        packed: packed records.
        head: the chunk's head.
        needs_crc: treat a chunk without CRC as damaged.

    Raises:
        DamageError: unknown compression, a size other than announced, or a wrong or missing CRC.
    """
    if head.unpacked > CHUNK_LIMIT_BYTES:
        raise DamageError(
            f"a chunk of {number_of(head.unpacked, 'byte')}, more than the {CHUNK_LIMIT_BYTES} that are unpacked"
        )
    if head.compression not in _UNPACKERS:
        known = ", ".join(name for name in _UNPACKERS if name)
        raise DamageError(
            f"a chunk compressed with {head.compression[:20]!r}, not with one of {known}: convert the file with 'mcap'"
        )
    try:
        data = _UNPACKERS[head.compression](packed, head.unpacked)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as fault:
        raise DamageError(f"a chunk whose {head.compression} data is damaged ({fault})") from fault
    if len(data) != head.unpacked:
        raise DamageError(f"a chunk of {number_of(len(data), 'byte')} instead of {head.unpacked}")
    if (head.crc or needs_crc) and crc32(data) != head.crc:
        raise DamageError("a chunk whose CRC is wrong")
    return data


def _unpack_nothing(packed: bytes | memoryview, unpacked: int) -> bytes:
    return bytes(packed[: unpacked + 1])


def _unpack_zstd(packed: bytes | memoryview, unpacked: int) -> bytes:
    """Return the content of all frames, of which at most one byte more than `unpacked` is decompressed."""
    if not hasattr(_per_thread, "decompressor"):
        _per_thread.decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_LIMIT_BYTES)
    if zstandard.frame_content_size(packed) == unpacked > 0:  # the usual case, in half the time
        try:
            return _per_thread.decompressor.decompress(packed, allow_extra_data=False)
        except zstandard.ZstdError:  # usual: more frames follow, or the data is damaged
            pass
    with _per_thread.decompressor.stream_reader(packed, read_across_frames=True) as stream:
        return stream.read(unpacked + 1)


def _unpack_lz4(packed: bytes | memoryview, unpacked: int) -> bytes:
    """As `_unpack_zstd`."""
    parts, room, tail = list[bytes](), unpacked + 1, bytes(packed)
    while tail and room:
        frame = lz4.frame.LZ4FrameDecompressor()
        part = cast("bytes", cast("Any", frame).decompress(tail, max_length=room))
        parts.append(part)
        room -= len(part)
        if room and not frame.eof:
            raise EOFError("a frame that is not whole")
        tail = cast("bytes | None", frame.unused_data) or b""
    return b"".join(parts)


_UNPACKERS = {"": _unpack_nothing, "zstd": _unpack_zstd, "lz4": _unpack_lz4}


@dataclass(frozen=True)
class ChunkTable:
    """Positions of the n chunks of a file, in file order, and their numbers of messages per channel.

    Attributes:
        start, length: int64 (n,), position and length of the whole record, bytes.
        unpacked: int64 (n,), size of its decompressed records, bytes.
        bare: bool (n,), True for a series of messages in the file without a chunk around them.
        start_ns, end_ns: int64 (n,), first and last log time.
        low_ns, high_ns: int64 (n,), bounds of log and publish times; NEVER_NS, EVER_NS if they are unknown.
        crc: uint32 (n,), CRC of the unpacked records, if they have been read; None for a table from an index.
        first_entry: int64 (n + 1,), index of each chunk's first entry.
        channel, count: (m,), channel id and number of messages per entry.
        index_at: int64 (m,), position of the entry's message index record in the file; -1 if there is none.
    """

    start: NDArray[np.int64]
    length: NDArray[np.int64]
    unpacked: NDArray[np.int64]
    bare: NDArray[np.bool_]
    start_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    low_ns: NDArray[np.int64]
    high_ns: NDArray[np.int64]
    crc: NDArray[np.uint32] | None
    first_entry: NDArray[np.int64]
    channel: NDArray[np.uint16]
    count: NDArray[np.int64]
    index_at: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    def numbers(self, window_ns: tuple[int, int] | None) -> NDArray[np.intp]:
        """Return the chunks that may contain messages with start ≤ time < end of the window; all for None."""
        if window_ns is None:
            return np.arange(len(self))
        return np.flatnonzero((self.high_ns >= window_ns[0]) & (self.low_ns < window_ns[1]))

    def alike(self) -> list[NDArray[np.intp]]:
        """Return groups of chunks, by number, with the same first and last log time and unpacked size."""
        if (self.start_ns[1:] > self.start_ns[:-1]).all():  # the usual case
            return []
        starts = np.sort(self.start_ns)
        chunks = np.flatnonzero(np.isin(self.start_ns, starts[1:][starts[1:] == starts[:-1]]))
        columns = np.stack([self.unpacked[chunks], self.end_ns[chunks], self.start_ns[chunks]])
        alike = np.lexsort(columns)
        other = (columns[:, alike[1:]] != columns[:, alike[:-1]]).any(axis=0)
        return [group for group in np.split(chunks[alike], np.flatnonzero(other) + 1) if len(group) > 1]

    def messages(self, chunks: NDArray[np.intp], channel_ids: Iterable[int]) -> NDArray[np.int64]:
        """Return the number of messages of some channels in each of `chunks` (ascending), shape as `chunks`."""
        if not len(chunks):
            return np.zeros(0, np.int64)
        first, last = int(chunks[0]), int(chunks[-1]) + 1
        begin, end = int(self.first_entry[first]), int(self.first_entry[last])
        wanted = np.zeros(65536, bool)
        wanted[list(channel_ids)] = True
        sums = np.zeros(end - begin + 1, np.int64)
        np.cumsum(np.where(wanted[self.channel[begin:end]], self.count[begin:end], 0), out=sums[1:])
        return sums[self.first_entry[chunks + 1] - begin] - sums[self.first_entry[chunks] - begin]

    def end_of_indexes(self, chunk: int, file_size: int) -> int:
        """Return the end of a chunk and of its message indexes, as far as the table lists them, bytes."""
        first, last = int(self.first_entry[chunk]), int(self.first_entry[chunk + 1])
        end = int(self.start[chunk] + self.length[chunk])
        if first < last and self.index_at[last - 1] >= 0:
            end = int(self.index_at[last - 1]) + INDEX_HEAD.size + INDEX_ENTRY_BYTES * int(self.count[last - 1])
        return min(end, file_size)

    def entries(self, chunk: int) -> list[tuple[int, int]]:
        """Return channel id and number of messages for each channel of one chunk."""
        part = slice(int(self.first_entry[chunk]), int(self.first_entry[chunk + 1]))
        return list(zip(self.channel[part].tolist(), self.count[part].tolist(), strict=True))

    def totals(self) -> dict[int, int]:
        """Return the number of messages by channel id, without channels that have none."""
        sums = np.zeros(65536, np.int64)
        np.add.at(sums, self.channel, self.count)
        return {int(channel): int(sums[channel]) for channel in np.flatnonzero(sums)}

    def span(self) -> tuple[int, int]:
        """Return first and last log time; zeros for a file without messages."""
        filled = self.first_entry[1:] > self.first_entry[:-1]
        return (int(self.start_ns[filled].min()), int(self.end_ns[filled].max())) if filled.any() else (0, 0)
