"""Reader of a finished MCAP file's summary: definitions, statistics, and the position of every chunk.

The summary is used only if its CRC is right and it is consistent in itself and with the file; otherwise the file must
be walked from the start (daq.mcap.reader).
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap.blocks import fields
from daq.mcap.checksum import crc32
from daq.mcap.chunks import EVER_NS, NEVER_NS, ChunkTable
from daq.mcap.file_bytes import FileBytes
from daq.mcap.open_chunk import INDEX_ENTRY_BYTES, INDEX_HEAD, MESSAGE_HEAD
from daq.mcap.records import RECORD_HEAD, DamageError, Definitions, parse
from daq.mcap.writer import MAGIC

_FOOTER_BYTES = RECORD_HEAD.size + 20
_LONGEST_DATA_END_BYTES = 64
_LARGEST_BYTES = 2**31
_FAR = 2**60  # sums of a few such numbers do not overflow
_INDEX_BYTES = 64  # of a chunk index without entries and without compression


@dataclass(frozen=True)
class FileSummary:
    """Summary of a finished file.

    Attributes:
        definitions: schemas and channels.
        statistics: counts and times.
        table: the chunks.
        attachments, metadata: their positions.
        data_end: end of the data section, bytes.
    """

    definitions: Definitions
    statistics: records.Statistics
    table: ChunkTable
    attachments: list[records.AttachmentIndex]
    metadata: list[records.MetadataIndex]
    data_end: int


def read_summary(file: FileBytes) -> FileSummary:
    """Read and verify the summary of a finished file.

    Raises:
        DamageError: the file is not finished, or its summary is damaged, has no CRC, or does not index everything.
    """
    try:
        tail = file.read(file.size - _FOOTER_BYTES - len(MAGIC), _FOOTER_BYTES + len(MAGIC))
        opcode, length = RECORD_HEAD.unpack_from(tail)
        if opcode != Opcode.FOOTER or length != 20 or tail[_FOOTER_BYTES:] != MAGIC:
            raise DamageError("no footer at the end")
        footer = parse(records.Footer, tail[RECORD_HEAD.size : _FOOTER_BYTES])
        end = file.size - len(tail)
        if not len(MAGIC) + RECORD_HEAD.size < footer.summary_start < end:
            raise DamageError("no summary")
        data_end = _data_end(file, footer.summary_start)
        if end - footer.summary_start > _LARGEST_BYTES:
            raise MemoryError
        data = file.read(footer.summary_start, end - footer.summary_start)
    except LogError as fault:
        raise DamageError(str(fault)) from fault
    except MemoryError as fault:
        raise DamageError("a summary larger than the available memory") from fault
    if crc32(tail[:25], crc32(data)) != footer.summary_crc:
        raise DamageError("a summary whose CRC is wrong or missing")
    return _parsed(data, data_end)


def _data_end(file: FileBytes, summary_start: int) -> int:
    """Return the position of the record before the summary, which later versions of the format may extend."""
    before = file.read(max(0, summary_start - _LONGEST_DATA_END_BYTES), min(summary_start, _LONGEST_DATA_END_BYTES))
    for size in range(RECORD_HEAD.size + 4, len(before) + 1):
        record = before[-size:]
        if RECORD_HEAD.unpack_from(record) == (Opcode.DATA_END, size - RECORD_HEAD.size):
            return summary_start - size
    raise DamageError("no end of the data before the summary")


def _parsed(data: bytes, data_end: int) -> FileSummary:
    """Return the summary after checking that it is consistent.

    Raises:
        DamageError: it is inconsistent, or does not index every message.
    """
    offsets = _record_offsets(data)
    sizes, offsets = np.diff(offsets), offsets[:-1]
    opcodes = fields(data, offsets, "u1")
    is_index = opcodes == Opcode.CHUNK_INDEX
    found = _Parts(Definitions(), [], [], [])
    places: list[tuple[int, int]] = list(zip(offsets[~is_index].tolist(), sizes[~is_index].tolist(), strict=True))
    for at, size in places:
        found.take(data[at], data[at + RECORD_HEAD.size : at + size])
    table = _table(data, offsets[is_index], sizes[is_index], data_end)
    if not found.statistics:
        raise DamageError("a summary without statistics")
    statistics, counts = found.statistics[-1], table.totals()
    if not set(counts) <= set(found.definitions.channels):
        raise DamageError("a summary that lacks channels")
    if (
        {channel: n for channel, n in statistics.channel_message_counts.items() if n} != counts
        or statistics.message_count != sum(counts.values())
        or statistics.chunk_count != len(table)
        or statistics.metadata_count != len(found.metadata)
        or statistics.attachment_count != len(found.attachments)
    ):
        raise DamageError("a summary that does not index everything")
    return FileSummary(found.definitions, statistics, table, found.attachments, found.metadata, data_end)


def _record_offsets(data: bytes) -> NDArray[np.int64]:
    """Return the offsets of the n records of a summary, and its end, (n + 1,).

    Raises:
        DamageError: it ends inside a record.
    """
    offsets, at, end = array("q", [0]), 0, len(data)
    while at <= end - RECORD_HEAD.size:
        at += RECORD_HEAD.size + RECORD_HEAD.unpack_from(data, at)[1]
        if at > end:
            break
        offsets.append(at)
    if at != end:
        raise DamageError("a summary that ends inside a record")
    return np.array(offsets)


@dataclass(frozen=True)
class _Parts:
    """Records of a summary other than chunk indexes."""

    definitions: Definitions
    statistics: list[records.Statistics]
    attachments: list[records.AttachmentIndex]
    metadata: list[records.MetadataIndex]

    def take(self, opcode: int, body: bytes) -> None:
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.definitions.take(opcode, body)
        elif opcode == Opcode.STATISTICS:
            self.statistics.append(parse(records.Statistics, body))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self.attachments.append(parse(records.AttachmentIndex, body))
        elif opcode == Opcode.METADATA_INDEX:
            self.metadata.append(parse(records.MetadataIndex, body))


def _table(data: bytes, offsets: NDArray[np.int64], sizes: NDArray[np.int64], data_end: int) -> ChunkTable:
    """Return the chunks that the chunk indexes at `offsets` list, which must be in order and must not overlap.

    The number of messages of a channel follows from the length of its message index, which ends where the next begins.

    Raises:
        DamageError: an index contradicts itself.
    """
    at, room = offsets + RECORD_HEAD.size, sizes - RECORD_HEAD.size - _INDEX_BYTES
    _need(room >= 0)
    map_bytes = fields(data, at + 32, "<u4").astype(np.int64)
    _need((map_bytes <= room) & (map_bytes % 10 == 0))
    name_bytes = fields(data, at + 44 + map_bytes, "<u4").astype(np.int64)
    _need(map_bytes + name_bytes <= room)  # later versions of the format may append fields
    first, last, start, length = (_numbers(data, at + k) for k in (0, 8, 16, 24))
    behind, packed, unpacked = (_numbers(data, at + 36 + map_bytes + k) for k in (0, 12 + name_bytes, 20 + name_bytes))
    _need((first >= 0) & (last >= 0))
    for column in (start, length, behind, packed, unpacked):
        _need((column >= 0) & (column < _FAR))
    end = start + length + behind
    _need(start[1:] >= end[:-1])
    if len(end) and end[-1] > data_end:
        raise DamageError("a chunk index that points beyond the data")
    entries = map_bytes // 10
    first_entry = np.concatenate([[0], np.cumsum(entries)])
    chunk = np.repeat(np.arange(len(at)), entries)
    entry_at = at[chunk] + 36 + 10 * (np.arange(len(chunk)) - first_entry[chunk])
    channel, index_at = fields(data, entry_at, "<u2"), _numbers(data, entry_at + 2)
    following = np.append(index_at[1:], 0)
    following[first_entry[1:][entries > 0] - 1] = end[entries > 0]
    content = following - index_at - INDEX_HEAD.size
    _need((index_at >= (start + length)[chunk]) & (content >= 0) & (content % INDEX_ENTRY_BYTES == 0))
    count = content // INDEX_ENTRY_BYTES
    _need(np.bincount(chunk, count, len(at)) <= unpacked // MESSAGE_HEAD.size)
    never, ever = (np.broadcast_to(np.array(value, np.int64), len(at)) for value in (NEVER_NS, EVER_NS))
    bare = np.broadcast_to(np.array(False), len(at))
    times = first, last, never, ever
    return ChunkTable(start, length, unpacked, bare, *times, None, first_entry, channel, count, index_at)


def _need(right: NDArray[np.bool_]) -> None:
    if not right.all():
        raise DamageError("a chunk index that contradicts itself")


def _numbers(data: bytes, offsets: NDArray[np.int64]) -> NDArray[Any]:
    """Return numbers of 8 bytes; those beyond 2^63 become negative."""
    return fields(data, offsets, "<i8")
