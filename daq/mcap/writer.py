"""MCAP writer that works in blocks: the message records of a batch of samples are made by one compiled loop.

The bytes follow the format's specification (https://mcap.dev/spec); rare records are encoded by the library's record
classes. A file consists of a header, chunks of messages each followed by its message indexes, attachments and metadata
between them, and a summary with indexes and statistics. A chunk and its indexes reach the stream in one write, so a
file cut anywhere contains whole chunks.

Not thread-safe: one thread writes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Literal, cast

import numpy as np
import zstandard
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray

from daq.mcap.checksum import crc32
from daq.mcap.open_chunk import RECORD_HEAD_BYTES, MessageBlock, OpenChunk, compile_loops, message_indexes
from daq.mcap.summary import WrittenChunk, WrittenCounts, encode_record
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
_CHUNK_HEAD = struct.Struct("<BQQQQII")


def metadata_crc(name: str, metadata: Mapping[str, str]) -> str:
    """Return the checksum of a named table of texts, 8 hex digits; MCAP itself has none for metadata.

    The key `METADATA_CRC` is excluded.
    """
    text = f"{name}\0" + "".join(f"{key}\0{value}\0" for key, value in sorted(metadata.items()) if key != METADATA_CRC)
    return f"{crc32(text.encode()):08x}"


def compile_writer() -> None:
    """Load or compile the compiled loops: takes seconds once per computer, and must not happen while samples arrive."""
    compile_loops()


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
        self._chunk_bytes = chunk_bytes
        self._library = library
        self._offset = self._crc = 0
        self._closed = ""  # reason why nothing can be written any more
        self._chunk = OpenChunk(chunk_bytes)
        self._restated_bytes = 0  # repeated definitions in the open chunk; these alone do not make a chunk
        self._definitions = b""
        self._summary = WrittenCounts()

    def start(self, profile: str = "") -> None:
        """Write magic and header; call it once, first."""
        compile_writer()
        self._write(MAGIC + encode_record(records.Header(profile, self._library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message schema; returns its id."""
        schema = records.Schema(id=_free_id(self._summary.schemas), name=name, encoding=encoding, data=data)
        self._define(schema)
        return schema.id

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Add a channel, at any time; schema 0 means no schema. Returns its id.

        Raises:
            ValueError: the schema is not registered.
        """
        channel = records.Channel(
            id=_free_id(self._summary.channels),
            topic=topic,
            message_encoding=message_encoding,
            schema_id=schema_id,
            metadata=dict(metadata or {}),
        )
        self._define(channel)
        return channel.id

    def adopt(self, schemas: Iterable[records.Schema], channels: Iterable[records.Channel]) -> None:
        """Adopt the definitions of another file with their ids, so that its chunks can be copied.

        Raises:
            ValueError: something is registered already, an id is invalid or occurs twice, or a channel's schema is not
                among them.
        """
        if self._summary.schemas or self._summary.channels:
            raise ValueError("expected to adopt definitions before any is registered: call adopt right after start")
        for definition in [*schemas, *channels]:
            self._define(definition)

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
        self._check_channel(channel_id)
        block = MessageBlock(messages, log_time_ns, publish_time_ns, sequence)
        done = 0
        while done < block.count:
            self._make_room(block.record_bytes)
            room = max(1, (self._chunk_bytes - self._chunk.size) // block.record_bytes)
            count = min(room, block.count - done)
            self._chunk.add_messages(channel_id, block, done, count)
            done += count

    def add_message(self, channel_id: int, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes) -> None:
        """Add one message of any size; sequence is taken modulo 2**32.

        Raises:
            ValueError: unknown channel, or times before 1970 or beyond 64 bits.
        """
        self._check_channel(channel_id)
        if not 0 <= min(log_time_ns, publish_time_ns) <= max(log_time_ns, publish_time_ns) < 2**64:
            raise ValueError(f"expected times in ns since 1970, got {log_time_ns} and {publish_time_ns}")
        self._make_room(RECORD_HEAD_BYTES + len(data))
        self._chunk.add_message(channel_id, log_time_ns, publish_time_ns, sequence & 0xFFFFFFFF, data)

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
        for channel_id in np.unique(ids):
            self._check_channel(int(channel_id))
        if len(places) and places.max() + RECORD_HEAD_BYTES > chunk.unpacked:
            raise ValueError(f"expected messages within {number_of(chunk.unpacked, 'byte')}, got one at {places.max()}")
        self._close_chunk()
        late, early = (int(np.where(a > b, a - b, 0).max(initial=0)) for a, b in ((log, publish), (publish, log)))
        self._put_chunk(chunk.packed, chunk.compression, chunk.unpacked, chunk.crc, (ids, log, places), (late, early))

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Add a named table of texts; its checksum is added under the key `METADATA_CRC`.

        Raises:
            ValueError: the table contains this key already.
        """
        self._check_open()
        if METADATA_CRC in metadata:
            raise ValueError(f"metadata {name!r}: expected no key {METADATA_CRC!r}: it is the record's own checksum")
        table = {storable(key): storable(text) for key, text in metadata.items()}
        table[METADATA_CRC] = metadata_crc(name, table)
        record = encode_record(records.Metadata(name=name, metadata=table))
        self._summary.add_metadata(records.MetadataIndex(self._offset, len(record), name))
        self._write(record)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Add an attached file."""
        self._check_open()
        record = encode_record(records.Attachment(0, log_time_ns, name, media_type, data))
        index = records.AttachmentIndex(self._offset, len(record), log_time_ns, 0, len(data), name, media_type)
        self._summary.add_attachment(index)
        self._write(record)

    def flush(self) -> None:
        """Close the open chunk and flush the stream, so that everything added survives the end of this process."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the times, the summary and the footer; nothing may be added afterwards."""
        self._close_chunk()
        times = {"most_late_ns": self._summary.most_late, "most_early_ns": self._summary.most_early}
        self.add_metadata(TIMES, {name: str(value) for name, value in times.items()})
        self._write(encode_record(records.DataEnd(self._crc)))
        self._write(self._summary.encode(self._offset) + MAGIC)
        self._closed = "the file is finished"
        self._stream.flush()

    def _check_open(self) -> None:
        if self._closed:
            raise OSError(f"expected a log that can be written, but {self._closed}")

    def _check_channel(self, channel_id: int) -> None:
        self._check_open()
        if channel_id not in self._summary.channels:
            known = sorted(self._summary.channels)
            raise ValueError(f"expected a channel of {known}, got {channel_id}: register it first")

    def _define(self, record: records.Schema | records.Channel) -> None:
        """Add a schema or channel to the open chunk, and keep it for repetition."""
        self._check_open()
        known: dict[int, Any]
        if isinstance(record, records.Schema):
            known, lowest = self._summary.schemas, 1
        else:
            known, lowest = self._summary.channels, 0
            if record.schema_id != 0 and record.schema_id not in self._summary.schemas:
                raise ValueError(
                    f"expected a registered schema for {record.topic!r}, got id {record.schema_id}: register it first"
                )
        if record.id in known or not lowest <= record.id <= 0xFFFF:
            raise ValueError(f"expected a new id of {lowest} … 65535, got {record.id} of {record}")
        data = encode_record(record)
        known[record.id] = record
        self._definitions += data
        self._chunk.append(data)

    def _make_room(self, record_bytes: int) -> None:
        """Close the open chunk if this record would exceed the size of a chunk."""
        if self._chunk.size + record_bytes > self._chunk_bytes:
            self._close_chunk()

    def _close_chunk(self) -> None:
        """Write the open chunk with its message indexes, if it is not empty."""
        self._check_open()
        if self._chunk.size == self._restated_bytes:
            return
        data = self._chunk.records
        late, early = self._chunk.extremes.tolist()
        packed = self._compressor.compress(data) if self._compressor else None
        name = "zstd" if self._compressor else ""
        self._put_chunk(packed, name, len(data), crc32(data), self._chunk.index, (late, early))
        self._chunk.clear()
        self._restated_bytes = 0
        if self._summary.chunk_count % RESTATE_EVERY == 0:
            self._chunk.append(self._definitions)
            self._restated_bytes = self._chunk.size

    def _put_chunk(
        self,
        packed: bytes | None,
        compression: str,
        unpacked: int,
        crc: int,
        messages: tuple[NDArray[np.uint16], NDArray[np.uint64], NDArray[np.uint64]],
        extremes: tuple[int, int],
    ) -> None:
        """Write a chunk and the message indexes of `messages` (channel ids, log times, offsets).

        If `packed` is None, the content is the open chunk's records, uncompressed.
        """
        log_times, start, name = messages[1], self._offset, compression.encode()
        times = (int(log_times.min()), int(log_times.max())) if len(log_times) else (0, 0)
        size = unpacked if packed is None else len(packed)
        length = _CHUNK_HEAD.size + len(name) + 8 + size
        head = _CHUNK_HEAD.pack(Opcode.CHUNK, length - 9, *times, unpacked, crc, len(name))
        head += name + size.to_bytes(8, "little")
        indexes, starts, counts = message_indexes(*messages)
        places = {channel_id: start + length + index_start for channel_id, index_start in starts.items()}
        if packed is None:
            self._write(self._chunk.framed(head, indexes))
        else:
            self._write(b"".join((head, packed, indexes)))
        self._summary.add_chunk(
            WrittenChunk(start, length, compression, size, unpacked, times, places, len(indexes), counts)
        )
        self._summary.most_late = max(self._summary.most_late, extremes[0])
        self._summary.most_early = max(self._summary.most_early, extremes[1])

    def _write(self, data: bytes | memoryview) -> None:
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


def _free_id(known: Mapping[int, Any]) -> int:
    """Return the lowest free id from 1 on."""
    return next(number for number in range(1, len(known) + 2) if number not in known)
