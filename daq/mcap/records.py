"""Records of an MCAP file that are no messages: header, definitions, metadata, attachments; each checked as it is read.

What no CRC covers is believed only in files of other writers: ours give every chunk, attachment, metadata record and
summary a CRC, so where it is missing there, it was damaged.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from io import BytesIO
from typing import Any

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zlib_ng.zlib_ng import crc32

from daq.errors import LogError
from daq.mcap.file_bytes import FileBytes
from daq.mcap.writer import LIBRARY, MAGIC, METADATA_CRC, metadata_crc

RECORD_HEAD = struct.Struct("<BQ")
_TEXT_LIMIT_BYTES = 64 * 2**20
_ALIKE = 0.7


class DamageError(Exception):
    """A record is not what its head or its CRC says."""


@dataclass(frozen=True)
class Header:
    """Who wrote a file.

    Attributes:
        library: as the header says; "" when the header cannot be read.
        ours: written by this package, so that every CRC must be there.
    """

    library: str
    ours: bool


def read_header(file: FileBytes) -> Header:
    """The file's header.

    Raises:
        LogError: the file does not begin like an MCAP file.
    """
    begin = file.read(0, min(file.size, 256))
    if begin[: len(MAGIC)] != MAGIC:
        raise LogError(f"expected an MCAP log that begins with {MAGIC!r}, got {begin[: len(MAGIC)]!r}")
    try:
        opcode, body = read_record(file, len(MAGIC), _TEXT_LIMIT_BYTES)
        library = parse(records.Header, body).library if opcode == Opcode.HEADER else ""
    except DamageError:
        library = ""
    if library.startswith(LIBRARY):
        return Header(library, True)
    # no CRC covers the header when the file was cut: a few flipped bits in it must not switch the checks off
    text = begin[len(MAGIC) :].decode("latin-1")
    alike = SequenceMatcher(None, LIBRARY, text[: 4 * len(LIBRARY)], autojunk=False)
    same = sum(block.size for block in alike.get_matching_blocks())
    return Header(library, same >= _ALIKE * len(LIBRARY))


def read_record(file: FileBytes, position: int, limit: int) -> tuple[int, bytes]:
    """Opcode and content of the record at `position`.

    Raises:
        DamageError: it does not fit into the file, is longer than `limit` bytes, or cannot be read.
    """
    try:
        opcode, length = RECORD_HEAD.unpack(file.read(position, RECORD_HEAD.size))
        if length > limit:
            raise DamageError(f"a record of kind {opcode:#04x} that announces {length} bytes")
        return opcode, file.read(position + RECORD_HEAD.size, length)
    except LogError as fault:
        raise DamageError(str(fault)) from fault


def parse(kind: Any, body: bytes) -> Any:
    """Read a record's content with the library's own class.

    Raises:
        DamageError: it cannot be read.
    """
    try:
        return kind.read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as fault:
        raise DamageError(f"a {kind.__name__.lower()} record that cannot be read ({fault})") from fault


@dataclass
class Definitions:
    """Schemas and channels by id; the first of an id counts, as the format forbids another."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)

    def take(self, opcode: int, body: bytes) -> None:
        """Add a definition.

        Raises:
            DamageError: it cannot be read, or is not what the same id meant before.
        """
        if opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, body)
            same = self.schemas.setdefault(schema.id, schema) == schema
        else:
            channel = parse(records.Channel, body)
            same = self.channels.setdefault(channel.id, channel) == channel
        if not same:
            raise DamageError("an id of a schema or channel that was given to another one before")

    def fill_up(self, others: Definitions) -> None:
        """Add what is not known yet."""
        self.schemas = others.schemas | self.schemas
        self.channels = others.channels | self.channels


def check_metadata(body: bytes, ours: bool) -> tuple[str, dict[str, str]]:
    """Name and texts of a metadata record, without our own CRC in it.

    Raises:
        DamageError: it cannot be read, or its CRC is wrong or missing.
    """
    metadata = parse(records.Metadata, body)
    texts = dict(metadata.metadata)
    crc = texts.pop(METADATA_CRC, None)
    if not ours and (crc is None or not re.fullmatch("[0-9a-f]{8}", crc) or crc != metadata_crc(metadata.name, texts)):
        return metadata.name, dict(metadata.metadata)  # another writer's, who may mean anything by this key
    if crc != metadata_crc(metadata.name, texts):
        raise DamageError(f"metadata {metadata.name[:80]!r} whose CRC is wrong")
    return metadata.name, texts


def read_metadata(file: FileBytes, start: int, ours: bool) -> tuple[str, dict[str, str]]:
    """Name and texts of the metadata record at byte `start`.

    Raises:
        DamageError: none is there, it cannot be read, or its CRC is wrong or missing.
    """
    opcode, body = read_record(file, start, _TEXT_LIMIT_BYTES)
    if opcode != Opcode.METADATA:
        raise DamageError(f"a record of kind {opcode:#04x} where metadata was expected")
    return check_metadata(body, ours)


@dataclass(frozen=True)
class AttachmentPlace:
    """Where an attachment's record stands: offset and length with its head, bytes; its name."""

    start: int
    length: int
    name: str


def check_attachment(file: FileBytes, start: int, ours: bool) -> AttachmentPlace:
    """Check the attachment record at byte `start` in bounded memory.

    Raises:
        DamageError: none is there, its lengths contradict each other, or its CRC is wrong or (ours) missing.
    """
    try:
        opcode, length = RECORD_HEAD.unpack(file.read(start, RECORD_HEAD.size))
        body = start + RECORD_HEAD.size
        end = body + length
        if opcode != Opcode.ATTACHMENT or length < 36 or end > file.size:
            raise DamageError("an attachment whose lengths contradict each other")
        at, texts = body + 16, []
        for _ in range(2):
            size = int.from_bytes(file.read(at, 4), "little")
            if at + 4 + size > end - 12:
                raise DamageError("an attachment whose lengths contradict each other")
            texts.append(file.read(at + 4, size))
            at += 4 + size
        if at + 8 + int.from_bytes(file.read(at, 8), "little") != end - 4:
            raise DamageError("an attachment whose lengths contradict each other")
        name = texts[0].decode("utf-8", "replace")
        crc = int.from_bytes(file.read(end - 4, 4), "little")
        if (crc or ours) and file.crc(body, end - 4) != crc:
            raise DamageError(f"attachment {name[:80]!r} whose CRC is wrong")
        return AttachmentPlace(start, length + RECORD_HEAD.size, name)
    except LogError as fault:
        raise DamageError(str(fault)) from fault


def read_attachment(file: FileBytes, place: AttachmentPlace, ours: bool) -> records.Attachment:
    """The attachment at a place; its CRC is checked on the very bytes that are handed out.

    Raises:
        DamageError: as `check_attachment`.
    """
    opcode, body = read_record(file, place.start, place.length - RECORD_HEAD.size)
    attachment = parse(records.Attachment, body) if opcode == Opcode.ATTACHMENT else None
    if attachment is None or attachment.name != place.name or len(body) + RECORD_HEAD.size != place.length:
        raise DamageError(f"something else where attachment {place.name[:80]!r} was expected")
    crc = int.from_bytes(body[-4:], "little")
    if (crc or ours) and crc32(body[:-4]) != crc:
        raise DamageError(f"attachment {place.name[:80]!r} whose CRC is wrong")
    return attachment
