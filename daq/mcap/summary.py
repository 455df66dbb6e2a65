"""Summary at the end of a log: its definitions repeated, statistics, and the positions of all records."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from daq.mcap.checksum import crc32

_PIECE_BYTES = 32 * 1024
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
_OFFSET_ENTRY = struct.Struct("<HQ")


@dataclass(frozen=True)
class WrittenChunk:
    """A chunk that was written.

    Attributes:
        start, length: position and length of its record in the file, bytes.
        compression: name of the compression, "" for none.
        packed, unpacked: sizes of its content, bytes.
        times: smallest and largest log time, ns.
        indexes: position in the file of each channel's message index record; `indexes_bytes` is their total length.
        counts: number of messages by channel.
    """

    start: int
    length: int
    compression: str
    packed: int
    unpacked: int
    times: tuple[int, int]
    indexes: Mapping[int, int]
    indexes_bytes: int
    counts: Mapping[int, int]


class WrittenCounts:
    """Counts of a file, collected while it is written.

    Attributes:
        schemas, channels: definitions by id.
        chunk_count: number of chunks so far.
        most_late, most_early: largest log time − publish time, and publish time − log time, of all messages, ns.
    """

    def __init__(self) -> None:
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, records.Channel] = {}
        self.chunk_count: int = 0
        self.most_late = self.most_early = 0
        self._counts: dict[int, int] = {}
        self._start_time, self._end_time = 2**64 - 1, 0
        # encoded, in pieces: an hour has 72 000 chunks, and one growing array would leave a hole in the heap each time
        # it moves
        self._chunk_indexes: list[bytes] = []
        self._piece = bytearray()
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []

    def add_chunk(self, chunk: WrittenChunk) -> None:
        """Add a chunk."""
        name = chunk.compression.encode()
        entries = b"".join(_OFFSET_ENTRY.pack(*entry) for entry in chunk.indexes.items())
        tail = struct.pack(f"<QI{len(name)}sQQ", chunk.indexes_bytes, len(name), name, chunk.packed, chunk.unpacked)
        size = _CHUNK_INDEX.size - 9 + len(entries) + len(tail)
        head = _CHUNK_INDEX.pack(Opcode.CHUNK_INDEX, size, *chunk.times, chunk.start, chunk.length, len(entries))
        self._piece += head + entries + tail
        if len(self._piece) > _PIECE_BYTES:
            self._chunk_indexes.append(bytes(self._piece))
            self._piece.clear()
        self.chunk_count += 1
        if chunk.counts:
            self._start_time = min(self._start_time, chunk.times[0])
            self._end_time = max(self._end_time, chunk.times[1])
        for channel_id, count in chunk.counts.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + count

    def add_attachment(self, index: records.AttachmentIndex) -> None:
        """Add an attachment."""
        self._attachment_indexes.append(index)

    def add_metadata(self, index: records.MetadataIndex) -> None:
        """Add a metadata record."""
        self._metadata_indexes.append(index)

    def encode(self, start: int) -> bytes:
        """Return summary, summary offsets and footer.

        Args:
            start: position of the summary in the file, bytes.
        """
        summary, offsets = bytearray(), b""
        for group in self._groups():
            if group:
                offset = records.SummaryOffset(Opcode(group[0]), start + len(summary), len(group))
                offsets += encode_record(offset)
                summary += group
        footer = encode_record(records.Footer(start, start + len(summary), 0))[:-4]
        summary += offsets + footer
        return bytes(summary) + crc32(summary).to_bytes(4, "little")

    def _groups(self) -> list[bytes | bytearray]:
        """Return the encoded records of the summary, one group per kind."""
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self.channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self.chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=self._end_time,
            message_start_time=min(self._start_time, self._end_time),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self.schemas),
        )
        kinds: list[Any] = [self.schemas.values(), self.channels.values(), [statistics]]
        definitions = [b"".join(encode_record(record) for record in kind) for kind in kinds]
        rest = [b"".join(map(encode_record, kind)) for kind in (self._attachment_indexes, self._metadata_indexes)]
        return [*definitions, b"".join([*self._chunk_indexes, self._piece]), *rest]


def encode_record(record: records.McapRecord) -> bytes:
    """Return a record as it is written to the file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
