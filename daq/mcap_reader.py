"""Walks an MCAP file from its start and keeps whatever is whole: finished, unfinished, cut or damaged files alike.

Chunks count only with the right CRC. Where a record makes no sense the walk looks for the next chunk and goes on.
No length in the file is believed before it is held against the bytes that are there.

Everything a damaged file lacks is said in `Contents.missing`; only a file that is no MCAP at all is an error.
"""

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from daq.errors import LogError
from daq.mcap_chunks import ChunkPlace, scan_records, unpack_chunk
from daq.mcap_writer import MAGIC

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_NEXT_CHUNK = re.compile(rb"\x06(?=.{36}(?:\x04\x00\x00\x00zstd|\x00\x00\x00\x00|\x03\x00\x00\x00lz4))", re.DOTALL)
_KNOWN = frozenset(Opcode)


class _DamageError(Exception):
    """A record is not what its header says."""


@dataclass
class Contents:
    """What a file holds.

    Attributes:
        chunks: chunks whose CRC is right, in file order.
        schemas, channels: by id.
        counts: messages by channel id.
        missing: what is not there or not right, in words; empty for a sound, finished file.
    """

    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)


def walk(file: Any, size: int) -> Contents:
    """Read a file's structure and check every CRC in it.

    Args:
        file: the whole file, anything that slices to bytes and supports the buffer protocol.
        size: its length, bytes.

    Raises:
        LogError: it does not begin like an MCAP file.
    """
    if bytes(file[:8]) != MAGIC:
        raise LogError(f"expected an MCAP log that begins with {MAGIC!r}, got {bytes(file[:8])!r}")
    return _Walk(file, size).run()


class _Walk:
    """One pass over the records of a file."""

    def __init__(self, file: Any, size: int) -> None:
        self.file, self.size = file, size
        self.contents = Contents()
        self.finished = False
        self.takers: dict[int, Callable[[int, bytes], None]] = {
            Opcode.SCHEMA: lambda _, body: self._define(Opcode.SCHEMA, body),
            Opcode.CHANNEL: lambda _, body: self._define(Opcode.CHANNEL, body),
            Opcode.METADATA: self._metadata,
            Opcode.ATTACHMENT: self._attachment,
            Opcode.DATA_END: self._data_end,
            Opcode.STATISTICS: self._statistics,
        }
        self.announced: int | None = None
        self.data_ended = False
        self.loose: list[ChunkPlace] = []
        self.search_from = len(MAGIC)  # behind the last chunk that was right, or behind the last one searched for

    def run(self) -> Contents:
        position = 8
        while position < self.size and not self.finished:
            try:
                position = self._record(position)
            except _DamageError as damage:
                position = self._resume(position, str(damage))
        self._keep_loose()
        missing = self.contents.missing
        if not self.finished:
            missing.append(f"the file was not finished or is cut: no footer in its {self.size} bytes")
        found = sum(self.contents.counts.values())
        if self.announced is not None and self.announced != found:
            missing.append(f"{self.announced - found} of {self.announced} messages")
        return self.contents

    def _record(self, position: int) -> int:
        """Take the record at `position`; returns where the next one starts."""
        if self.size - position < _HEAD.size:
            raise _DamageError("the file ends inside a record's head")
        opcode, length = _HEAD.unpack(self.file[position : position + _HEAD.size])
        start = position + _HEAD.size
        if opcode == 0:
            raise _DamageError("a record of kind 0, which does not exist")
        if length > self.size - start:
            raise _DamageError(f"the file ends inside a record: {length} bytes announced, {self.size - start} left")
        end = start + length
        if opcode == Opcode.CHUNK:
            self._chunk(start, length)
        elif opcode == Opcode.MESSAGE:
            self._loose_message(position, end)
        elif opcode == Opcode.FOOTER:
            self._footer(start, length)
        elif opcode in self.takers:
            self._take(opcode, start, bytes(self.file[start:end]))
        elif opcode == Opcode.MESSAGE_INDEX:
            if length < 6 or int.from_bytes(self.file[start + 2 : start + 6], "little") != length - 6:
                raise _DamageError("a message index of another length than it says")
        elif opcode < 0x80 and opcode not in _KNOWN:
            self.contents.missing.append(f"byte {position}: a record of unknown kind {opcode:#04x} was skipped")
        return end

    def _resume(self, position: int, why: str) -> int:
        """Note the damage and find the next chunk; the end of the file when there is none.

        The search begins behind the last right chunk, not here: a wrong length may have jumped over some.
        """
        self.contents.missing.append(f"byte {position}: {why}")
        for match in _NEXT_CHUNK.finditer(self.file, self.search_from):
            start = match.start() + _HEAD.size
            length = int.from_bytes(self.file[match.start() + 1 : start], "little")
            if length <= self.size - start and self._chunk_place(start, length) is not None:
                self.search_from = match.start() + 1
                return match.start()
        self.search_from = self.size
        return self.size

    def _chunk_place(self, start: int, length: int) -> ChunkPlace | None:
        """The chunk whose record content stands at `start`; None if its lengths contradict each other."""
        if length < _CHUNK_HEAD.size + 8:
            return None
        _, _, unpacked, crc, name_bytes = _CHUNK_HEAD.unpack(self.file[start : start + _CHUNK_HEAD.size])
        if name_bytes > length - _CHUNK_HEAD.size - 8:
            return None
        name_at = start + _CHUNK_HEAD.size
        data_at = name_at + name_bytes + 8
        packed = int.from_bytes(self.file[data_at - 8 : data_at], "little")
        if data_at + packed != start + length:
            return None
        name = bytes(self.file[name_at : name_at + name_bytes]).decode("ascii", "replace")
        return ChunkPlace(data_at, packed, unpacked, name, crc)

    def _chunk(self, start: int, length: int) -> None:
        place = self._chunk_place(start, length)
        if place is None:
            raise _DamageError("a chunk whose lengths contradict each other")
        self._keep(place, start - _HEAD.size)

    def _loose_message(self, position: int, end: int) -> None:
        """A message outside of chunks, where no CRC covers it."""
        if self.loose and self.loose[-1].start + self.loose[-1].packed == position:
            start = self.loose.pop().start
        else:
            start = position
        self.loose.append(ChunkPlace(start, end - start, end - start, "", 0))

    def _keep_loose(self) -> None:
        """Messages outside of chunks count only in a file without chunks; beside chunks they are damaged records."""
        if self.contents.chunks and self.loose:
            self.contents.missing.append(f"{len(self.loose)} stretches of messages outside of chunks were left out")
            return
        for place in self.loose:
            self._keep(place, place.start)

    def _keep(self, place: ChunkPlace, position: int) -> None:
        try:
            scan = scan_records(unpack_chunk(self.file, place))
        except LogError as fault:
            self.contents.missing.append(f"byte {position}: a chunk was left out: {fault}")
            return
        self.contents.chunks.append(place)
        self.search_from = max(self.search_from, place.start + place.packed)
        for row in np.flatnonzero((scan.opcodes == Opcode.SCHEMA) | (scan.opcodes == Opcode.CHANNEL)):
            body = scan.data[scan.offsets[row] : scan.offsets[row] + scan.lengths[row]].tobytes()
            self._take(int(scan.opcodes[row]), position, body)
        ids = scan.channel_ids()
        for channel_id, count in zip(*np.unique(ids[ids >= 0], return_counts=True), strict=True):
            self.contents.counts[int(channel_id)] = self.contents.counts.get(int(channel_id), 0) + int(count)

    def _take(self, opcode: int, start: int, body: bytes) -> None:
        try:
            self.takers[opcode](start, body)
        except (McapError, struct.error, UnicodeDecodeError, OverflowError) as fault:
            raise _DamageError(f"a {Opcode(opcode).name.lower()} record that cannot be read ({fault})") from fault

    def _define(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(stream)
            self.contents.schemas.setdefault(schema.id, schema)
        else:
            channel = records.Channel.read(stream)
            self.contents.channels.setdefault(channel.id, channel)

    def _metadata(self, _: int, body: bytes) -> None:
        metadata = records.Metadata.read(ReadDataStream(BytesIO(body)))
        self.contents.metadata[metadata.name] = metadata.metadata

    def _attachment(self, start: int, body: bytes) -> None:
        attachment = records.Attachment.read(ReadDataStream(BytesIO(body)))
        crc = int.from_bytes(body[-4:], "little")
        if crc and zlib.crc32(body[:-4]) != crc:
            self.contents.missing.append(f"byte {start}: attachment {attachment.name!r} has a wrong CRC, left out")
        else:
            self.contents.attachments[attachment.name] = attachment.data

    def _data_end(self, start: int, body: bytes) -> None:
        self.data_ended = True
        crc = records.DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
        if crc and self._crc(0, start - _HEAD.size) != crc:
            self.contents.missing.append("the data section's CRC is wrong: the file was changed after writing")

    def _statistics(self, _: int, body: bytes) -> None:
        self.announced = records.Statistics.read(ReadDataStream(BytesIO(body))).message_count

    def _footer(self, start: int, length: int) -> None:
        if length != 20 or not self.data_ended:
            raise _DamageError("a footer of another length than 20 bytes, or before the end of the data")
        summary_start, _, crc = struct.unpack("<QQI", self.file[start : start + 20])
        if crc and self._crc(summary_start or start - _HEAD.size, start + 16) != crc:
            self.contents.missing.append("the summary's CRC is wrong")
        self.finished = bytes(self.file[start + 20 : start + 28]) == MAGIC

    def _crc(self, start: int, end: int) -> int:
        """CRC of a stretch of the file, without copying it."""
        with memoryview(self.file) as whole, whole[start:end] as part:
            return zlib.crc32(part)
