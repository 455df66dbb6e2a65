"""MCAP written in blocks: the message records of a whole batch of samples are one numpy array.

The bytes are the format's own (https://mcap.dev/spec); the library's record classes write everything but messages and
chunks. A file is a header, chunks of messages each followed by its message indexes, attachments and metadata between
them, then a summary with the indexes and statistics. A chunk and its indexes reach the stream in one write, so a file
cut anywhere holds whole chunks.

Not thread-safe: one thread writes.
"""

import zlib
from collections.abc import Mapping
from functools import cache
from typing import Any, BinaryIO, Literal

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray

MAGIC = b"\x89MCAP0\r\n"
RESTATE_EVERY = 64
"""Schemas and channels are repeated in every so many-th chunk: a file that lost its first chunk stays readable."""
_ZSTD_LEVEL = 1  # a third of the time of level 3 for a few per cent of the size


@cache
def record_dtype(message_bytes: int) -> np.dtype[Any]:
    """Layout of a message record with a payload of constant size, its opcode and length included."""
    fields = [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
    return np.dtype([*fields, ("message", f"V{message_bytes}")] if message_bytes else fields)


RECORD_HEAD_BYTES = record_dtype(0).itemsize
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class _OpenChunk:
    """Records gathered for the next chunk."""

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        self.size = self.restated_bytes = 0
        self.indexes: dict[int, list[NDArray[Any]]] = {}
        self.start_time, self.end_time = 2**64 - 1, 0

    def append(self, part: bytes | memoryview) -> None:
        self.parts.append(part)
        self.size += len(part)

    def index(self, channel_id: int, log_times: NDArray[np.uint64], record_bytes: int) -> None:
        """Note where the next records will stand."""
        entries = np.empty(len(log_times), _INDEX_ENTRY)
        entries["log_time"] = log_times
        entries["offset"] = self.size + record_bytes * np.arange(len(log_times), dtype=np.uint64)
        self.indexes.setdefault(channel_id, []).append(entries)
        self.start_time = min(self.start_time, int(log_times.min()))
        self.end_time = max(self.end_time, int(log_times.max()))


class BlockWriter:
    """Writes one MCAP file to a stream.

    Args:
        stream: where the bytes go; it is flushed by `flush` and `finish` and never closed here.
        compression: of the chunks.
        chunk_bytes: size at which a chunk is closed, before compression.
        library: who wrote the file, for its header.

    Raises (all methods):
        OSError: the stream cannot be written, for instance because the disk is full.
    """

    def __init__(
        self,
        stream: BinaryIO,
        compression: Literal["zstd", "none"] = "zstd",
        chunk_bytes: int = 256 * 1024,
        library: str = "pendulum-balancer-rig",
    ) -> None:
        if compression not in ("zstd", "none"):
            raise ValueError(f"expected compression 'zstd' or 'none', got {compression!r}")
        self._stream = stream
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL) if compression == "zstd" else None
        self._chunk_bytes = chunk_bytes
        self._library = library
        self._offset = 0
        self._crc = 0
        self._chunk = _OpenChunk()
        self._definitions = b""
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._counts: dict[int, int] = {}
        self._start_time, self._end_time = 2**64 - 1, 0
        self._chunk_indexes: list[records.ChunkIndex] = []
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []

    def start(self, profile: str = "") -> None:
        """Write magic and header; call it once, first."""
        self._write(MAGIC + _record(records.Header(profile, self._library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message schema; returns its id."""
        schema = records.Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._define(schema)
        return schema.id

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Add a channel, at any time; schema 0 means none. Returns its id."""
        if not 0 <= schema_id <= len(self._schemas):
            raise ValueError(f"expected a registered schema for {topic!r}, got id {schema_id}: register it first")
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=message_encoding,
            schema_id=schema_id,
            metadata=dict(metadata or {}),
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._define(channel)
        return channel.id

    def add_block(
        self,
        channel_id: int,
        log_time_ns: ArrayLike,
        publish_time_ns: ArrayLike,
        sequence: ArrayLike,
        messages: NDArray[Any],
    ) -> None:
        """Add n messages of one size.

        Args:
            channel_id: from `register_channel`.
            log_time_ns: one time for all, or (n,), ns.
            publish_time_ns: (n,) or one for all, ns.
            sequence: (n,) or one for all; taken modulo 2**32.
            messages: (n,) of any dtype whose items are whole messages.

        Raises:
            ValueError: unknown channel, negative times, or lengths that differ.
        """
        self._check_channel(channel_id)
        if messages.ndim != 1:
            raise ValueError(f"expected messages of shape (n,), got {messages.shape}")
        if not len(messages):
            return
        block = np.empty(len(messages), record_dtype(messages.dtype.itemsize))
        block["opcode"] = Opcode.MESSAGE
        block["length"] = block.dtype.itemsize - 9
        block["channel_id"] = channel_id
        block["sequence"] = np.asarray(sequence, np.int64) & 0xFFFFFFFF
        for name, times in (("log_time", log_time_ns), ("publish_time", publish_time_ns)):
            nanoseconds = np.asarray(times, np.int64)
            if nanoseconds.min(initial=0) < 0:
                raise ValueError(f"expected {name} in ns since 1970, got {nanoseconds.min()}")
            block[name] = nanoseconds
        if messages.dtype.itemsize:
            block["message"] = np.ascontiguousarray(messages).view(f"V{messages.dtype.itemsize}")
        size, start = block.dtype.itemsize, 0
        while start < len(block):
            room = max(1, (self._chunk_bytes - self._chunk.size) // size)
            part = block[start : start + room]
            self._chunk.index(channel_id, part["log_time"], size)
            self._append(channel_id, part.view(np.uint8).data, len(part))
            start += len(part)

    def add_message(self, channel_id: int, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes) -> None:
        """Add one message of any size; sequence is taken modulo 2**32.

        Raises:
            ValueError: unknown channel or negative times.
        """
        self._check_channel(channel_id)
        if log_time_ns < 0 or publish_time_ns < 0:
            raise ValueError(f"expected times in ns since 1970, got {log_time_ns} and {publish_time_ns}")
        message = records.Message(channel_id, log_time_ns, data, publish_time_ns, sequence & 0xFFFFFFFF)
        self._chunk.index(channel_id, np.array([log_time_ns], np.uint64), 0)
        self._append(channel_id, _record(message), 1)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Add a named table of texts."""
        record = _record(records.Metadata(name=name, metadata=dict(metadata)))
        self._metadata_indexes.append(records.MetadataIndex(self._offset, len(record), name))
        self._write(record)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Add a file."""
        record = _record(records.Attachment(0, log_time_ns, name, media_type, data))
        index = records.AttachmentIndex(self._offset, len(record), log_time_ns, 0, len(data), name, media_type)
        self._attachment_indexes.append(index)
        self._write(record)

    def flush(self) -> None:
        """Close the open chunk and flush the stream: what was added so far survives the end of this process."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the summary and the footer; nothing may be added after."""
        self._close_chunk()
        self._write(_record(records.DataEnd(self._crc)))
        summary_start, summary, offsets = self._offset, b"", []
        for group in self._summary_groups():
            body = b"".join(_record(record) for record in group)
            offsets.append(records.SummaryOffset(body[0], summary_start + len(summary), len(body)))
            summary += body
        offset_start = summary_start + len(summary)
        summary += b"".join(_record(offset) for offset in offsets)
        footer = _record(records.Footer(summary_start, offset_start, 0))[:-4]
        crc = zlib.crc32(summary + footer)
        self._write(summary + footer + crc.to_bytes(4, "little") + MAGIC)
        self._stream.flush()

    def _summary_groups(self) -> list[list[Any]]:
        """Records of the summary, grouped by kind; empty groups are left out."""
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts={channel: count for channel, count in self._counts.items() if count},
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._end_time,
            message_start_time=min(self._start_time, self._end_time),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: list[list[Any]] = [self._schemas, self._channels, [statistics], self._chunk_indexes]
        groups += [self._attachment_indexes, self._metadata_indexes]
        return [group for group in groups if group]

    def _check_channel(self, channel_id: int) -> None:
        if channel_id not in self._counts:
            raise ValueError(f"expected a channel of {sorted(self._counts)}, got {channel_id}: register it first")

    def _define(self, record: records.Schema | records.Channel) -> None:
        """Put a schema or channel into the open chunk, and keep it for repeating."""
        data = _record(record)
        self._definitions += data
        self._chunk.append(data)

    def _append(self, channel_id: int, data: bytes | memoryview, count: int) -> None:
        self._chunk.append(data)
        self._counts[channel_id] += count
        if self._chunk.size >= self._chunk_bytes:
            self._close_chunk()

    def _close_chunk(self) -> None:
        """Write the open chunk with its message indexes, if there is anything in it."""
        if self._chunk.size == self._chunk.restated_bytes:
            return
        chunk, self._chunk = self._chunk, _OpenChunk()
        data = b"".join(chunk.parts)
        packed = self._compressor.compress(data) if self._compressor else data
        compression = "zstd" if self._compressor else ""
        start_time = min(chunk.start_time, chunk.end_time)
        record = _record(records.Chunk(compression, packed, chunk.end_time, start_time, zlib.crc32(data), len(data)))
        index_offsets, indexes, position = {}, [], self._offset + len(record)
        for channel_id, parts in sorted(chunk.indexes.items()):
            index_offsets[channel_id] = position
            indexes.append(_message_index(channel_id, np.concatenate(parts)))
            position += len(indexes[-1])
        self._chunk_indexes.append(
            records.ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=self._offset,
                compression=compression,
                compressed_size=len(packed),
                message_end_time=chunk.end_time,
                message_index_length=position - self._offset - len(record),
                message_index_offsets=index_offsets,
                message_start_time=start_time,
                uncompressed_size=len(data),
            )
        )
        if chunk.indexes:
            self._start_time = min(self._start_time, chunk.start_time)
            self._end_time = max(self._end_time, chunk.end_time)
        self._write(b"".join([record, *indexes]))
        if len(self._chunk_indexes) % RESTATE_EVERY == 0:
            self._chunk.append(self._definitions)
            self._chunk.restated_bytes = self._chunk.size

    def _write(self, data: bytes) -> None:
        written = self._stream.write(data)
        if written is not None and written != len(data):
            raise OSError(f"expected {len(data)} bytes to be written, only {written} were: is the disk full?")
        self._offset += len(data)
        self._crc = zlib.crc32(data, self._crc)


def _record(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _message_index(channel_id: int, entries: NDArray[Any]) -> bytes:
    """Message index record: (log time, offset) of one channel's messages in a chunk, in order of log time."""
    log_times = entries["log_time"]
    if (log_times[1:] < log_times[:-1]).any():
        entries = entries[np.argsort(log_times, kind="stable")]
    body = channel_id.to_bytes(2, "little") + entries.nbytes.to_bytes(4, "little") + entries.tobytes()
    return bytes([Opcode.MESSAGE_INDEX]) + len(body).to_bytes(8, "little") + body
