"""MCAP writer that works in blocks: the message records of a batch of samples are one numpy array.

Rare records are encoded by the mcap library. A file consists of a header, chunks of messages each followed by its
message indexes, attachments and metadata between them, and a summary with indexes and statistics. A chunk and its
indexes reach the stream in one write, so a file cut anywhere contains whole chunks.

Not thread-safe: one thread writes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, BinaryIO, Literal, cast

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray

from daq.mcap.checksum import crc32
from daq.mcap.open_chunk import LOG_NS, MESSAGE_HEAD, PUBLISH_NS, SEQUENCE, OpenChunk
from rig_basics.texts import number_of, storable

MAGIC = b"\x89MCAP0\r\n"
RESTATE_EVERY = 64
"""Period in chunks at which schemas and channels are repeated: a file without its first chunk remains readable."""
METADATA_CRC = "crc32"
"""Key of a metadata record under which its own checksum is stored."""
LIBRARY = "self-balancing rotor rig, log layout 2"
"""Name of the writer in the header. Files with this name must contain every checksum. Layout 1, with the package's name
in the header, had none for metadata; its files are read like those of other writers."""
TIMES = "times"
"""Name of the metadata record that contains the largest differences between sample times and log times."""
_ZSTD_LEVEL = 3  # 10 % smaller files than level 1 in 20 % more time; higher levels take twice the time for no gain
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_CHUNK_INDEX_HEAD = struct.Struct("<BQQQQQI")
_MAP_ENTRY = struct.Struct("<HQ")


def metadata_crc(name: str, metadata: Mapping[str, str]) -> str:
    """Return the checksum of a named table of texts, 8 hex digits; MCAP itself has none for metadata.

    The key `METADATA_CRC` is excluded.
    """
    text = f"{name}\0" + "".join(f"{key}\0{value}\0" for key, value in sorted(metadata.items()) if key != METADATA_CRC)
    return f"{crc32(text.encode()):08x}"


def encode_record(record: records.McapRecord) -> bytes:
    """Return a record as it is written to the file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@dataclass(frozen=True)
class CopiedChunk:
    """A chunk of another file with n messages.

    Attributes:
        packed: its content as stored in the other file.
        compression: "" or the name of the compression.
        unpacked: size of the unpacked content, bytes.
        crc: CRC of the unpacked content, as stored in the other file.
        channel_ids, log_times, publish_times, offsets: (n,) each: channel ids, times in ns, and the offset of each
            message record (its opcode) in the unpacked content.
    """

    packed: bytes
    compression: str
    unpacked: int
    crc: int
    channel_ids: ArrayLike
    log_times: ArrayLike
    publish_times: ArrayLike
    offsets: ArrayLike


class BlockWriter:
    """Writes one MCAP file to a stream.

    Args:
        stream: output stream; flushed by `flush` and `finish` and never closed here.
        compression: compression of the chunks.
        chunk_bytes: largest size of a chunk before compression, unless a single message is larger. For sizes up to
            256 KiB zstd uses tables that give 5 % smaller samples in less time.
        library: name of the writer for the header.

    Raises (all methods):
        OSError: the stream cannot be written, for instance because the disk is full, or an earlier write failed, or the
            file is finished. Everything written before remains readable.
    """

    def __init__(
        self,
        stream: BinaryIO,
        compression: Literal["zstd", "none"] = "zstd",
        chunk_bytes: int = 256 * 1024,
        library: str = LIBRARY,
    ) -> None:
        if compression not in ("zstd", "none"):
            raise ValueError(f"expected compression 'zstd' or 'none', got {compression!r}")
        self._stream = stream
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL) if compression == "zstd" else None
        self._chunk = OpenChunk(chunk_bytes)
        self._library = library
        self._offset = self._crc = 0
        self._closed = ""  # reason why nothing can be written any more
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._chunk_indexes: list[bytes] = []  # encoded: an hour has 72 000
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []

    def start(self, profile: str = "") -> None:
        """Write magic and header; call it once, first."""
        self._write(MAGIC + encode_record(records.Header(profile, self._library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message schema; returns its id."""
        schema = records.Schema(id=_free_id(self._schemas), name=name, encoding=encoding, data=data)
        self._add_schema(schema)
        return schema.id

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Add a channel, at any time; schema 0 means no schema. Returns its id.

        Raises:
            ValueError: the schema is not registered.
        """
        channel = records.Channel(
            id=_free_id(self._channels),
            topic=topic,
            message_encoding=message_encoding,
            schema_id=schema_id,
            metadata=dict(metadata or {}),
        )
        self._add_channel(channel)
        return channel.id

    def adopt(self, schemas: Iterable[records.Schema], channels: Iterable[records.Channel]) -> None:
        """Adopt the definitions of another file with their ids, so that its chunks can be copied.

        Raises:
            ValueError: something is registered already, an id is invalid or occurs twice, or a channel's schema is not
                among them.
        """
        if self._schemas or self._channels:
            raise ValueError("expected to adopt definitions before any is registered: call adopt right after start")
        for schema in schemas:
            self._add_schema(schema)
        for channel in channels:
            self._add_channel(channel)

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
            ValueError: unknown channel, negative times, values that are not integers, or different lengths.
        """
        if messages.ndim != 1:
            raise ValueError(f"expected messages of shape (n,), got {messages.shape}")
        item = _opaque(messages.itemsize)
        columns = {name: messages.view(item.dtype[name]) for name in item.dtype.names or ()}
        heads = log_time_ns, publish_time_ns, sequence
        self._add_rows(channel_id, item, _heads(*heads, len(messages)) | columns, len(messages))

    def add_samples(
        self,
        channel_id: int,
        log_time_ns: ArrayLike,
        publish_time_ns: NDArray[np.int64],
        sequence: ArrayLike,
        item: NDArray[Any],
        columns: Mapping[str, ArrayLike],
    ) -> None:
        """Add n messages of one layout by their fields; other arguments as `add_block`.

        Args:
            publish_time_ns: (n,).
            item: structured array (1,): a message with the values of the fields that are the same in all; for speed
                the same array at each call.
            columns: values (n,), or one for all, of the other fields by name.

        Raises:
            ValueError: as `add_block`.
        """
        count = len(publish_time_ns)
        heads = _heads(log_time_ns, publish_time_ns, sequence, count)
        self._add_rows(channel_id, item, heads | {name: np.asarray(of) for name, of in columns.items()}, count)

    def _add_rows(self, channel_id: int, item: NDArray[Any], columns: dict[str, NDArray[Any]], count: int) -> None:
        self._check_channel(channel_id)
        size, done = MESSAGE_HEAD.size + item.itemsize, 0
        while done < count:
            self._make_room(size)
            part = slice(done, min(done + self._chunk.fitting(size), count))
            rows = columns
            if part != slice(0, count):
                rows = {name: values[part] if values.size > 1 else values for name, values in columns.items()}
            self._chunk.add_rows(channel_id, item, rows, part.stop - done)
            done = part.stop

    def add_message(self, channel_id: int, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes) -> None:
        """Add one message of any size; sequence is taken modulo 2**32.

        Raises:
            ValueError: unknown channel, or times before 1970 or beyond 64 bits.
        """
        self._check_channel(channel_id)
        if not 0 <= min(log_time_ns, publish_time_ns) <= max(log_time_ns, publish_time_ns) < 2**64:
            raise ValueError(f"expected times in ns since 1970, got {log_time_ns} and {publish_time_ns}")
        self._make_room(MESSAGE_HEAD.size + len(data))
        self._chunk.add_message(channel_id, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns, data)

    def copy_chunk(self, chunk: CopiedChunk) -> None:
        """Add a whole chunk of another file unchanged, with a new message index; an open chunk is closed first.

        Raises:
            ValueError: a channel that was not adopted, different lengths, or a message outside of the chunk.
        """
        ids = np.ascontiguousarray(chunk.channel_ids, np.uint16)
        log, publish, places = (
            np.ascontiguousarray(a, np.uint64) for a in (chunk.log_times, chunk.publish_times, chunk.offsets)
        )
        if not ids.shape == log.shape == publish.shape == places.shape or ids.ndim != 1:
            raise ValueError(
                f"expected four arrays (n,), got {ids.shape}, {log.shape}, {publish.shape} and {places.shape}"
            )
        for channel_id in np.unique(ids).tolist():
            self._check_channel(channel_id)
        if len(places) and places.max() + MESSAGE_HEAD.size > chunk.unpacked:
            raise ValueError(f"expected messages within {number_of(chunk.unpacked, 'byte')}, got one at {places.max()}")
        self._close_chunk()
        for channel_id in np.unique(ids):
            rows = ids == channel_id
            self._chunk.index.add_rows(int(channel_id), log[rows], publish[rows], places[rows])
        self._put_chunk(chunk.packed, chunk.compression, chunk.unpacked, chunk.crc)

    def add_metadata(self, name: str, metadata: Mapping[str, str], checksum: bool = True) -> None:
        """Add a named table of texts.

        Args:
            checksum: add its checksum under the key `METADATA_CRC`.

        Raises:
            ValueError: the table contains this key already.
        """
        self._check_open()
        table = {storable(key): storable(text) for key, text in metadata.items()}
        if checksum:
            if METADATA_CRC in table:
                raise ValueError(
                    f"metadata {name!r}: expected no key {METADATA_CRC!r}: it is the record's own checksum"
                )
            table[METADATA_CRC] = metadata_crc(name, table)
        record = encode_record(records.Metadata(name=name, metadata=table))
        self._metadata_indexes.append(records.MetadataIndex(self._offset, len(record), name))
        self._write(record)

    def add_attachment(
        self, name: str, media_type: str, data: bytes, log_time_ns: int, create_time_ns: int = 0
    ) -> None:
        """Add an attached file; times in ns since 1970, create time 0 if it is unknown."""
        self._check_open()
        record = encode_record(records.Attachment(create_time_ns, log_time_ns, name, media_type, data))
        times = log_time_ns, create_time_ns
        index = records.AttachmentIndex(self._offset, len(record), *times, len(data), name, media_type)
        self._attachment_indexes.append(index)
        self._write(record)

    def flush(self) -> None:
        """Close the open chunk and flush the stream, so that everything added survives the end of this process."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the times, the summary and the footer; nothing may be added afterwards."""
        self._close_chunk()
        index = self._chunk.index
        self.add_metadata(TIMES, {"most_late_ns": str(index.late_ns), "most_early_ns": str(index.early_ns)})
        self._write(encode_record(records.DataEnd(self._crc)))
        self._write(self._summary())
        self._closed = "the file is finished"
        self._stream.flush()

    def _summary(self) -> bytes:
        """Return summary, summary offsets, footer and the end of the file."""
        index = self._chunk.index
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=index.counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(index.counts.values()),
            message_end_time=index.last_ns,
            message_start_time=min(index.first_ns, index.last_ns),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: list[Iterable[bytes]] = [
            map(encode_record, self._schemas.values()),
            map(encode_record, self._channels.values()),
            [encode_record(statistics)],
            self._chunk_indexes,
            map(encode_record, self._attachment_indexes),
            map(encode_record, self._metadata_indexes),
        ]
        summary, offsets = bytearray(), b""
        for group in groups:
            start = len(summary)
            summary += b"".join(group)
            if len(summary) > start:
                place = self._offset + start, len(summary) - start
                offsets += encode_record(records.SummaryOffset(Opcode(summary[start]), *place))
        footer = records.Footer(self._offset, self._offset + len(summary), 0)
        summary += offsets + encode_record(footer)[:-4]
        return bytes(summary) + crc32(summary).to_bytes(4, "little") + MAGIC

    def _check_open(self) -> None:
        if self._closed:
            raise OSError(f"expected a log that can be written, but {self._closed}")

    def _check_channel(self, channel_id: int) -> None:
        self._check_open()
        if channel_id not in self._channels:
            known = sorted(self._channels)
            raise ValueError(f"expected a channel of {known}, got {channel_id}: register it first")

    def _add_schema(self, schema: records.Schema) -> None:
        self._check_id(schema, self._schemas, 1)
        self._schemas[schema.id] = schema
        self._add(schema)

    def _add_channel(self, channel: records.Channel) -> None:
        if channel.schema_id != 0 and channel.schema_id not in self._schemas:
            raise ValueError(
                f"expected a registered schema for {channel.topic!r}, got id {channel.schema_id}: register it first"
            )
        self._check_id(channel, self._channels, 0)
        self._channels[channel.id] = channel
        self._add(channel)

    def _check_id(self, record: records.Schema | records.Channel, known: Mapping[int, Any], lowest: int) -> None:
        self._check_open()
        if record.id in known or not lowest <= record.id <= 0xFFFF:
            raise ValueError(f"expected a new id of {lowest} … 65535, got {record.id} of {record}")

    def _add(self, record: records.McapRecord) -> None:
        """Add a definition to the open chunk."""
        self._chunk.add(encode_record(record))

    def _make_room(self, record_bytes: int) -> None:
        """Close the open chunk if this record would exceed the size of a chunk."""
        if not self._chunk.fitting(record_bytes):
            self._close_chunk()

    def _close_chunk(self) -> None:
        """Write the open chunk with its message indexes, if it is not empty."""
        self._check_open()
        if not self._chunk.is_filled:
            return
        data = self._chunk.take()
        packed, name = (self._compressor.compress(data), "zstd") if self._compressor else (data, "")
        self._put_chunk(packed, name, len(data), crc32(data))
        if len(self._chunk_indexes) % RESTATE_EVERY == 0:
            for record in (*self._schemas.values(), *self._channels.values()):
                self._chunk.add(encode_record(record), is_repeated=True)

    def _put_chunk(self, packed: bytes, compression: str, unpacked: int, crc: int) -> None:
        """Write a chunk, and the message indexes of the messages added since the last one."""
        indexes, starts, (first, last) = self._chunk.index.take()
        name = len(compression).to_bytes(4, "little") + compression.encode()
        length = _CHUNK_HEAD.size + len(name) + 8 + len(packed)
        head = _CHUNK_HEAD.pack(Opcode.CHUNK, length - 9, first, last, unpacked, crc)
        after = self._offset + length
        offsets = b"".join(_MAP_ENTRY.pack(channel_id, after + start) for channel_id, start in starts.items())
        place = first, last, self._offset, length, len(offsets)
        self._chunk_indexes.append(
            _CHUNK_INDEX_HEAD.pack(Opcode.CHUNK_INDEX, 60 + len(offsets) + len(name), *place)
            + offsets
            + len(indexes).to_bytes(8, "little")
            + name
            + struct.pack("<QQ", len(packed), unpacked)
        )
        self._write(b"".join((head, name, len(packed).to_bytes(8, "little"), packed, indexes)))

    def _write(self, data: bytes) -> None:
        self._check_open()
        self._closed = "writing it failed before"  # reset below: data after an incomplete record are unreadable
        written = cast("int | None", self._stream.write(data))  # None: an unbuffered stream that would block
        if written is not None and written != len(data):
            raise OSError(
                f"expected {number_of(len(data), 'byte')} to be written, only {written} were: is the disk full?"
            )
        self._closed = ""
        self._offset += len(data)
        self._crc = crc32(data, self._crc)


@lru_cache
def _opaque(size: int) -> NDArray[Any]:
    """Return the layout of messages of `size` bytes whose fields are not distinguished."""
    return np.zeros(1, [("message", f"V{size}")] if size else [])


def _heads(log_ns: ArrayLike, publish_ns: ArrayLike, sequence: ArrayLike, count: int) -> dict[str, NDArray[Any]]:
    """Return log times, publish times and sequences as columns of `count` messages.

    Raises:
        ValueError: another shape than () or (count,), values that are not integers, or times before 1970.
    """
    columns = {LOG_NS: np.asarray(log_ns), PUBLISH_NS: np.asarray(publish_ns), SEQUENCE: np.asarray(sequence)}
    for name, array in columns.items():
        if array.dtype.kind not in "iu" or array.shape not in ((), (1,), (count,)):
            got = f"{array.dtype} of shape {array.shape}"
            raise ValueError(f"expected {name} as one integer or {count}, got {got}")
        if name != SEQUENCE:
            times = array.astype(np.int64, copy=False)
            least = times.item() if times.size == 1 else int(np.minimum.reduce(times, initial=0))
            if least < 0:
                raise ValueError(f"expected {name} in ns since 1970, got {least}")
    return columns


def _free_id(known: Mapping[int, Any]) -> int:
    """Return the lowest free id from 1 on."""
    return next(number for number in range(1, len(known) + 2) if number not in known)
