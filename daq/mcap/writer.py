"""MCAP written in blocks: the message records of a whole batch of samples are made by one compiled loop.

The bytes are the format's own (https://mcap.dev/spec); the library's record classes write what there is little of. A
file is a header, chunks of messages each followed by its message indexes, attachments and metadata between them, then
a summary with the indexes and statistics. A chunk and its indexes reach the stream in one write, so a file cut
anywhere holds whole chunks.

Not thread-safe: one thread writes.
"""

import struct
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO, Literal

import numpy as np
import zstandard
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray
from zlib_ng.zlib_ng import crc32

from daq.mcap.open_chunk import RECORD_HEAD_BYTES, MessageBlock, OpenChunk, compile_loops, message_indexes
from daq.mcap.summary import Summary, encode_record

MAGIC = b"\x89MCAP0\r\n"
RESTATE_EVERY = 64
"""Schemas and channels are repeated in every so many-th chunk: a file that lost its first chunk stays readable."""
METADATA_CRC = "crc32"
"""Key of a metadata record under which its own checksum stands."""
LIBRARY = "self-balancing rotor rig, log layout 2"
"""Who wrote a file, as its header says: from it every checksum is expected. Layout 1, which called itself by the
package's name, had none for metadata; its files are read like those of others."""
TIMES = "times"
"""Name of the metadata record that says how far sample times and log times are apart."""
_ZSTD_LEVEL = 3  # a tenth smaller than level 1 for a fifth more time; the levels above cost twice as much for nothing
_CHUNK_HEAD = struct.Struct("<BQQQQII")


def metadata_crc(name: str, metadata: Mapping[str, str]) -> str:
    """Checksum of a named table of texts, 8 hex digits; MCAP itself has none for metadata.

    A key `METADATA_CRC` among them is left out.
    """
    text = f"{name}\0" + "".join(f"{key}\0{value}\0" for key, value in sorted(metadata.items()) if key != METADATA_CRC)
    return f"{crc32(text.encode()):08x}"


def compile_writer() -> None:
    """Load what is compiled, or compile it: seconds once on a machine, and never while samples wait."""
    compile_loops()


class BlockWriter:
    """Writes one MCAP file to a stream.

    Args:
        stream: where the bytes go; it is flushed by `flush` and `finish` and never closed here.
        compression: of the chunks.
        chunk_bytes: largest size of a chunk before compression, unless a single message is larger. zstd has tables
            for up to 256 KiB that make samples 5 % smaller, and faster, than those for more.
        library: who wrote the file, for its header.

    Raises (all methods):
        OSError: the stream cannot be written, for instance because the disk is full, or could not before, or the file
            is finished. What was written until then stays readable.
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
        self._closed = ""  # why nothing can be written any more
        self._chunk = OpenChunk(chunk_bytes)
        self._restated_bytes = 0  # of the open chunk: definitions repeated, for which alone no chunk is written
        self._definitions = b""
        self._summary = Summary()

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
        """Add a channel, at any time; schema 0 means none. Returns its id.

        Raises:
            ValueError: no such schema.
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
        """Take over the definitions of another file with their ids, so that its chunks can be copied.

        Raises:
            ValueError: something is registered already, an id occurs twice or is no id, or a channel's schema is not
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
            ValueError: unknown channel, negative times, no integers, or lengths that differ.
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
            ValueError: unknown channel, or times before 1970 or that 64 bits do not hold.
        """
        self._check_channel(channel_id)
        if not 0 <= min(log_time_ns, publish_time_ns) <= max(log_time_ns, publish_time_ns) < 2**64:
            raise ValueError(f"expected times in ns since 1970, got {log_time_ns} and {publish_time_ns}")
        self._make_room(RECORD_HEAD_BYTES + len(data))
        self._chunk.add_message(channel_id, log_time_ns, publish_time_ns, sequence & 0xFFFFFFFF, data)

    def copy_chunk(
        self,
        packed: bytes,
        compression: str,
        unpacked: int,
        crc: int,
        channel_ids: ArrayLike,
        log_times: ArrayLike,
        publish_times: ArrayLike,
        offsets: ArrayLike,
    ) -> None:
        """Add a whole chunk of another file as it is, with a fresh message index; an open chunk is closed first.

        Args:
            packed: its content as it stands in the other file.
            compression: "" or the name of the compression.
            unpacked: size of the content when unpacked, bytes.
            crc: of the unpacked content, as the other file has it.
            channel_ids, log_times, publish_times, offsets: (n,) each, of its n messages: times in ns, and where the
                message record (its opcode) starts in the unpacked content.

        Raises:
            ValueError: a channel that was not adopted, lengths that differ, or a message outside of the chunk.
        """
        ids = np.ascontiguousarray(channel_ids, np.uint16)
        log, publish, places = (np.ascontiguousarray(a, np.uint64) for a in (log_times, publish_times, offsets))
        if not ids.shape == log.shape == publish.shape == places.shape or ids.ndim != 1:
            raise ValueError(
                f"expected four arrays (n,), got {ids.shape}, {log.shape}, {publish.shape} and {places.shape}"
            )
        for channel_id in np.unique(ids):
            self._check_channel(int(channel_id))
        if len(places) and places.max() + RECORD_HEAD_BYTES > unpacked:
            raise ValueError(f"expected messages within {unpacked} bytes, got one at {places.max()}")
        self._close_chunk()
        late, early = (int(np.where(a > b, a - b, 0).max(initial=0)) for a, b in ((log, publish), (publish, log)))
        self._put_chunk(packed, compression, unpacked, crc, (ids, log, places), (late, early))

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Add a named table of texts; it gets its checksum under the key `METADATA_CRC`.

        Raises:
            ValueError: it has such a key already.
        """
        self._check_open()
        if METADATA_CRC in metadata:
            raise ValueError(f"metadata {name!r}: expected no key {METADATA_CRC!r}: it is the record's own checksum")
        table = {**metadata, METADATA_CRC: metadata_crc(name, metadata)}
        record = encode_record(records.Metadata(name=name, metadata=table))
        self._summary.add_metadata(records.MetadataIndex(self._offset, len(record), name))
        self._write(record)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Add a file."""
        self._check_open()
        record = encode_record(records.Attachment(0, log_time_ns, name, media_type, data))
        index = records.AttachmentIndex(self._offset, len(record), log_time_ns, 0, len(data), name, media_type)
        self._summary.add_attachment(index)
        self._write(record)

    def flush(self) -> None:
        """Close the open chunk and flush the stream: what was added so far survives the end of this process."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the times, the summary and the footer; nothing may be added after."""
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
        """Put a schema or channel into the open chunk, and keep it for repeating."""
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
        """Close the open chunk if such a record would make it larger than a chunk is to be."""
        if self._chunk.size + record_bytes > self._chunk_bytes:
            self._close_chunk()

    def _close_chunk(self) -> None:
        """Write the open chunk with its message indexes, if there is anything in it."""
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
        """Write a chunk and the message indexes of its (channel ids, log times, offsets).

        Without `packed` its content are the records of the open chunk as they are.
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
        self._summary.add_chunk(start, length, compression, size, unpacked, times, places, len(indexes), counts)
        self._summary.most_late = max(self._summary.most_late, extremes[0])
        self._summary.most_early = max(self._summary.most_early, extremes[1])

    def _write(self, data: bytes | memoryview) -> None:
        self._check_open()
        self._closed = "writing it failed before"  # unless this goes well: behind half a record nothing is readable
        written = self._stream.write(data)
        if written is not None and written != len(data):
            raise OSError(f"expected {len(data)} bytes to be written, only {written} were: is the disk full?")
        self._closed = ""
        self._offset += len(data)
        self._crc = crc32(data, self._crc)


def _free_id(known: Mapping[int, Any]) -> int:
    """The lowest id from 1 on that is not taken."""
    return next(number for number in range(1, len(known) + 2) if number not in known)
