"""Records of an MCAP file other than messages: header, definitions, metadata, attachments; each is verified when read.

Data without a CRC are accepted only in files of other writers. This package writes a CRC for every chunk, attachment,
metadata record and summary; if it is missing in one of its files, the file is damaged.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from io import BytesIO
from typing import Any, NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from daq.errors import LogError
from daq.mcap.checksum import crc32
from daq.mcap.file_bytes import FileBytes
from daq.mcap.writer import LIBRARY, MAGIC, METADATA_CRC, metadata_crc
from rig_basics.texts import number_of

RECORD_HEAD = struct.Struct("<BQ")
_TEXT_LIMIT_BYTES = 64 * 2**20
_ALIKE = 0.7


class DamageError(Exception):
    """A record does not match its head or its CRC."""


@dataclass(frozen=True)
class Header:
    """Program that wrote a file.

    Attributes:
        library: name in the header; "" if the header cannot be read.
        ours: True if written by this package, so that every CRC must be present.
        profile: profile in the header.
    """

    library: str
    ours: bool
    profile: str = ""


def read_header(file: FileBytes) -> Header:
    """Read the file's header.

    Raises:
        LogError: the file does not begin like an MCAP file.
    """
    begin = file.read(0, min(file.size, 256))
    if begin[: len(MAGIC)] != MAGIC:
        raise LogError(f"expected an MCAP log that begins with {MAGIC!r}, got {begin[: len(MAGIC)]!r}")
    try:
        opcode, body = read_record(file, len(MAGIC), _TEXT_LIMIT_BYTES)
        header = parse(records.Header, body) if opcode == Opcode.HEADER else records.Header("", "")
    except DamageError:  # usual: the writer is recognized by similar text below
        header = records.Header("", "")
    if header.library.startswith(LIBRARY):
        return Header(header.library, True, header.profile)
    # no CRC covers the header when the file was cut: a few flipped bits must not disable the checks
    text = begin[len(MAGIC) :].decode("latin-1")
    alike = SequenceMatcher(None, LIBRARY, text[: 4 * len(LIBRARY)], autojunk=False)
    same = sum(block.size for block in alike.get_matching_blocks())
    return Header(header.library, same >= _ALIKE * len(LIBRARY), header.profile)


def read_record(file: FileBytes, position: int, limit: int) -> tuple[int, bytes]:
    """Return opcode and content of the record at `position`.

    Raises:
        DamageError: the record does not fit into the file, is longer than `limit` bytes, or cannot be read.
    """
    try:
        opcode, length = RECORD_HEAD.unpack(file.read(position, RECORD_HEAD.size))
        if length > limit:
            raise DamageError(f"a record of kind {opcode:#04x} that announces {number_of(length, 'byte')}")
        return opcode, file.read(position + RECORD_HEAD.size, length)
    except LogError as fault:
        raise DamageError(str(fault)) from fault


def parse(kind: Any, body: bytes) -> Any:
    """Parse a record's content with the library's own class.

    Raises:
        DamageError: the content cannot be parsed.
    """
    return _parsed(kind, body)[0]


def _parsed(kind: Any, body: bytes) -> tuple[Any, int]:
    """Return the record, and the number of bytes of its known fields; later versions of the format may append some."""
    stream = ReadDataStream(BytesIO(body))
    try:
        return kind.read(stream), stream.count
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as fault:
        raise DamageError(f"a {kind.__name__.lower()} record that cannot be read ({fault})") from fault


@dataclass
class Definitions:
    """Schemas and channels by id; the first definition of an id is used, since the format forbids others."""

    schemas: dict[int, records.Schema] = field(default_factory=dict[int, records.Schema])
    channels: dict[int, records.Channel] = field(default_factory=dict[int, records.Channel])

    def take(self, opcode: int, body: bytes) -> None:
        """Add a definition.

        Raises:
            DamageError: it cannot be parsed, or differs from an earlier definition of the same id.
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
        """Add definitions with new ids."""
        self.schemas = others.schemas | self.schemas
        self.channels = others.channels | self.channels


class Facts(NamedTuple):
    """A metadata record: its name, its texts without this package's CRC, and whether it has one."""

    name: str
    texts: dict[str, str]
    has_crc: bool


def check_metadata(body: bytes, ours: bool) -> Facts:
    """Return the facts of a metadata record.

    Raises:
        DamageError: the record cannot be parsed, or its CRC is wrong or missing.
    """
    metadata = parse(records.Metadata, body)
    texts = dict(metadata.metadata)
    crc = texts.pop(METADATA_CRC, None)
    if not ours and (crc is None or not re.fullmatch("[0-9a-f]{8}", crc) or crc != metadata_crc(metadata.name, texts)):
        return Facts(
            metadata.name, dict(metadata.metadata), False
        )  # of another writer, which may use this key for anything
    if crc != metadata_crc(metadata.name, texts):
        raise DamageError(f"metadata {metadata.name[:80]!r} whose CRC is wrong")
    return Facts(metadata.name, texts, True)


def read_metadata(file: FileBytes, start: int, ours: bool) -> Facts:
    """Return the facts of the metadata record at byte `start`.

    Raises:
        DamageError: there is another record, it cannot be parsed, or its CRC is wrong or missing.
    """
    opcode, body = read_record(file, start, _TEXT_LIMIT_BYTES)
    if opcode != Opcode.METADATA:
        raise DamageError(f"a record of kind {opcode:#04x} where metadata was expected")
    return check_metadata(body, ours)


@dataclass(frozen=True)
class AttachmentPlace:
    """Position of an attachment's record: offset and length including its head, bytes; and its name."""

    start: int
    length: int
    name: str


def check_attachment(file: FileBytes, start: int, ours: bool) -> tuple[AttachmentPlace, bool]:
    """Verify the attachment record at byte `start` in bounded memory.

    Returns:
        Its place, and whether it has a CRC.

    Raises:
        DamageError: there is another record, its lengths contradict each other, or its CRC is wrong or (ours) missing.
    """
    try:
        opcode, length = RECORD_HEAD.unpack(file.read(start, RECORD_HEAD.size))
        body, end = start + RECORD_HEAD.size, start + RECORD_HEAD.size + length
        if opcode != Opcode.ATTACHMENT or length < 36 or end > file.size:
            raise DamageError("an attachment whose lengths contradict each other")
        at, texts = body + 16, list[bytes]()
        for _ in range(2):
            size = int.from_bytes(file.read(at, 4), "little")
            if at + 4 + size > end - 12:
                raise DamageError("an attachment whose lengths contradict each other")
            texts.append(file.read(at + 4, size))
            at += 4 + size
        at += 8 + int.from_bytes(file.read(at, 8), "little")  # later versions of the format may append fields
        if at > end - 4:
            raise DamageError("an attachment whose lengths contradict each other")
        name = texts[0].decode("utf-8", "replace")
        crc = int.from_bytes(file.read(at, 4), "little")
        if (crc or ours) and file.crc(body, at) != crc:
            raise DamageError(f"attachment {name[:80]!r} whose CRC is wrong")
        return AttachmentPlace(start, length + RECORD_HEAD.size, name), bool(crc)
    except LogError as fault:
        raise DamageError(str(fault)) from fault


def read_attachment(file: FileBytes, place: AttachmentPlace, ours: bool) -> records.Attachment:
    """Read the attachment at a place; the CRC is verified for exactly the bytes that are returned.

    Raises:
        DamageError: as `check_attachment`.
    """
    opcode, body = read_record(file, place.start, place.length - RECORD_HEAD.size)
    attachment, used = _parsed(records.Attachment, body) if opcode == Opcode.ATTACHMENT else (None, 0)
    if attachment is None or attachment.name != place.name or len(body) + RECORD_HEAD.size != place.length:
        raise DamageError(f"something else where attachment {place.name[:80]!r} was expected")
    crc = int.from_bytes(body[used - 4 : used], "little")
    if (crc or ours) and crc32(body[: used - 4]) != crc:
        raise DamageError(f"attachment {place.name[:80]!r} whose CRC is wrong")
    return attachment
