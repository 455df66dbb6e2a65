"""Reader of a finished MCAP file's summary: definitions, statistics, and the position of every chunk.

The summary is used only if its CRC is right and it is consistent in itself and with the file; otherwise the file must
be walked from the start (daq.mcap.reader). It is read in pieces, so that an index of many megabytes needs no memory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mcap import records
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, MetadataIndex, Statistics
from numpy.typing import NDArray

from daq.errors import LogError
from daq.mcap.checksum import crc32
from daq.mcap.chunks import EVER_NS, NEVER_NS, ChunkTable
from daq.mcap.file_bytes import FileBytes
from daq.mcap.records import RECORD_HEAD, DamageError, Definitions, Header, parse
from daq.mcap.scan import chunk_indexes
from daq.mcap.writer import MAGIC

_FOOTER_BYTES = RECORD_HEAD.size + 20
_DATA_END_BYTES = RECORD_HEAD.size + 4
_PIECE_BYTES = 256 * 1024  # stays in the processor's cache between reading, CRC and parsing
_MIN_INDEX_BYTES = RECORD_HEAD.size + 64
_MIN_ENTRY_BYTES = 10


@dataclass
class FileSummary:
    """Summary of a finished file.

    Attributes:
        definitions: schemas and channels.
        statistics: counts and times; None if the writer stored none.
        table: the chunks.
        attachments, metadata: their positions.
        data_end: end of the data section, bytes.
        data_crc: CRC of the data section, not verified; 0 if the writer stored none.
    """

    definitions: Definitions
    statistics: Statistics | None
    table: ChunkTable
    attachments: list[AttachmentIndex]
    metadata: list[MetadataIndex]
    data_end: int
    data_crc: int


def read_summary(file: FileBytes, header: Header) -> FileSummary:
    """Read and verify the summary of a finished file.

    Raises:
        DamageError: the file is not finished, or its summary is damaged, has no CRC, or does not index everything.
    """
    try:
        tail = file.read(file.size - _FOOTER_BYTES - len(MAGIC), _FOOTER_BYTES + len(MAGIC))
        opcode, length = RECORD_HEAD.unpack_from(tail)
        if opcode != Opcode.FOOTER or length != 20 or tail[_FOOTER_BYTES:] != MAGIC:
            raise DamageError("no footer at the end")
        start = int.from_bytes(tail[9:17], "little")
        crc = int.from_bytes(tail[25:29], "little")
        end = file.size - len(tail)
        if not len(MAGIC) + _DATA_END_BYTES < start < end:
            raise DamageError("no summary")
        data_end = file.read(start - _DATA_END_BYTES, _DATA_END_BYTES)
        if RECORD_HEAD.unpack_from(data_end) != (Opcode.DATA_END, 4):
            raise DamageError("no end of the data before the summary")
        reading = _Reading(file, start, end)
        reading.run()
        if crc32(tail[:25], reading.crc) != crc:
            raise DamageError("a summary whose CRC is wrong or missing")
    except LogError as fault:
        raise DamageError(str(fault)) from fault
    except MemoryError as fault:
        raise DamageError("a summary larger than the available memory") from fault
    return reading.summary(start - _DATA_END_BYTES, int.from_bytes(data_end[-4:], "little"), header)


@dataclass
class _Reading:
    """One pass over the summary's bytes."""

    file: FileBytes
    start: int
    end: int
    crc: int = 0
    definitions: Definitions = field(default_factory=Definitions)
    statistics: Statistics | None = None
    attachments: list[AttachmentIndex] = field(default_factory=list[AttachmentIndex])
    metadata: list[MetadataIndex] = field(default_factory=list[MetadataIndex])

    def __post_init__(self) -> None:
        # capacity for the largest possible number: pages that are never written cost nothing
        most, entries = (self.end - self.start) // _MIN_INDEX_BYTES, (self.end - self.start) // _MIN_ENTRY_BYTES
        numbers, self.first_entry, self.counts, self.channels, self.kinds = _in_one_piece(
            (np.int64, 6 * most), (np.int64, most + 1), (np.uint32, entries), (np.uint16, entries), (np.uint8, most)
        )
        self.numbers = numbers.reshape(6, most)
        self.first_entry[0] = 0
        self.totals = np.zeros(65536, np.int64)
        self.state = np.zeros(3, np.int64)

    def run(self) -> None:
        """Read every record.

        Raises:
            DamageError, LogError: the summary cannot be read.
        """
        position, size, checked = self.start, _PIECE_BYTES, self.start
        while position < self.end:
            piece = self.file.read(position, min(size, self.end - position))
            self.crc = crc32(memoryview(piece)[checked - position :], self.crc)
            checked, size = position + len(piece), _PIECE_BYTES
            taken = self._take(piece)
            position += taken
            if not taken:  # a long or a damaged record
                size = RECORD_HEAD.size + RECORD_HEAD.unpack_from(piece.ljust(RECORD_HEAD.size, b"\xff"))[1]
                if size > self.end - position:
                    raise DamageError("a summary that ends inside a record")

    def _take(self, block: bytes) -> int:
        """Read the whole records at the start of `block`; return the position of the rest."""
        position, data = 0, np.frombuffer(block, np.uint8)
        while len(block) - position >= RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack_from(block, position)
            if length > len(block) - position - RECORD_HEAD.size:
                return position
            if opcode == Opcode.CHUNK_INDEX:
                arrays = self.numbers, self.kinds, self.first_entry, self.channels, self.counts, self.totals, self.state
                taken = int(chunk_indexes(data[position:], *arrays))
                if taken <= 0:
                    raise DamageError("a chunk index that contradicts itself")
                position += taken
                continue
            end = position + RECORD_HEAD.size + length
            self._record(opcode, block[position + RECORD_HEAD.size : end])
            position = end
        return position

    def _record(self, opcode: int, body: bytes) -> None:
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.definitions.take(opcode, body)
        elif opcode == Opcode.STATISTICS:
            self.statistics = parse(records.Statistics, body)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self.attachments.append(parse(records.AttachmentIndex, body))
        elif opcode == Opcode.METADATA_INDEX:
            self.metadata.append(parse(records.MetadataIndex, body))

    def summary(self, data_end: int, data_crc: int, header: Header) -> FileSummary:
        """Return the result after checking that it is consistent.

        Raises:
            DamageError: it is inconsistent, or does not index every message.
        """
        if self.state[2] > data_end:
            raise DamageError("a chunk index that points beyond the data")
        statistics, found = self.statistics, self.counts_by_channel()
        if not set(found) <= set(self.definitions.channels):
            raise DamageError("a summary that lacks channels")
        if statistics is None:
            if header.ours or not len(found):
                raise DamageError("a summary without statistics")
        elif (
            {channel: n for channel, n in statistics.channel_message_counts.items() if n} != found
            or statistics.message_count != sum(found.values())
            or statistics.chunk_count != self.state[0]
            or statistics.metadata_count != len(self.metadata)
            or statistics.attachment_count != len(self.attachments)
        ):
            raise DamageError("a summary that does not index everything")
        parts = self._table(), self.attachments, self.metadata
        return FileSummary(self.definitions, statistics, *parts, data_end, data_crc)

    def counts_by_channel(self) -> dict[int, int]:
        """Return the number of messages by channel id, without channels that have none."""
        return {int(channel): int(self.totals[channel]) for channel in np.flatnonzero(self.totals)}

    def _table(self) -> ChunkTable:
        chunks, entries = int(self.state[0]), int(self.state[1])
        start, length, packed, unpacked, first, last = (self.numbers[k, :chunks] for k in range(6))
        return ChunkTable(
            start,
            length,
            packed,
            unpacked,
            self.kinds[:chunks],
            first,
            last,
            _constant(chunks, NEVER_NS),
            _constant(chunks, EVER_NS),
            None,
            self.first_entry[: chunks + 1],
            self.channels[:entries],
            self.counts[:entries],
        )


def _constant(count: int, value: int) -> NDArray[np.int64]:
    return np.broadcast_to(np.array(value, np.int64), (count,))


def _in_one_piece(*wanted: tuple[type[np.generic], int]) -> list[NDArray[Any]]:
    """Return arrays of the given types and lengths (wider types first) in one block of memory.

    One large block causes far fewer page faults than several small ones, which would cost more than all writing.
    """
    ends = np.cumsum([np.dtype(kind).itemsize * length for kind, length in wanted])
    parts = np.split(np.empty(ends[-1], np.uint8), ends[:-1])
    return [part.view(kind) for part, (kind, _) in zip(parts, wanted, strict=True)]
