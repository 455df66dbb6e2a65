"""The 416 files of the format's conformance suite, made from its specification.

Six contents are combined with ten features of a file: chunks, indexes, statistics, repeated definitions, summary
offsets, and records that are longer than their known fields.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
_EXTRA = b"\x01\xff\xff"
_OF_CHUNKS = (records.Schema, records.Channel, records.Message)
_FIXED = (records.Footer, records.DataEnd, records.Message, records.Chunk)
_SCHEMA = records.Schema(1, b"\x04\x05\x06", "c", "Example")
_CHANNEL = records.Channel(1, "example", "a", {"foo": "bar"}, 1)
_TIMES = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)

CONTENTS: dict[str, list[records.McapRecord]] = {
    "NoData": [],
    "OneSchemalessMessage": [
        records.Channel(1, "example", "text", {}, 0),
        records.Message(1, 2, b"\x01\x02\x03", 1, 10),
    ],
    "OneMessage": [_SCHEMA, _CHANNEL, records.Message(1, 2, b"\x01\x02\x03", 1, 10)],
    "OneAttachment": [records.Attachment(1, 2, "myFile", "application/octet-stream", b"\x01\x02\x03")],
    "OneMetadata": [records.Metadata("myMetadata", {"foo": "bar"})],
    "TenMessages": [
        _SCHEMA,
        _CHANNEL,
        *(records.Message(1, time, b"\x01\x02\x03", time, number) for number, time in enumerate(_TIMES)),
    ],
}
FEATURES = (
    "UseChunks",
    "UseMessageIndex",
    "UseStatistics",
    "UseRepeatedSchemas",
    "UseRepeatedChannelInfos",
    "UseAttachmentIndex",
    "UseMetadataIndex",
    "UseChunkIndex",
    "UseSummaryOffset",
    "AddExtraDataToRecords",
)
_NEEDED = {
    "UseRepeatedSchemas": records.Schema,
    "UseRepeatedChannelInfos": records.Channel,
    "UseAttachmentIndex": records.Attachment,
    "UseMetadataIndex": records.Metadata,
    "UseChunks": records.Message,
}
_IN_SUMMARY = {*_NEEDED, "UseStatistics", "UseChunkIndex"} - {"UseChunks"}


@dataclass(frozen=True)
class Case:
    """One file: its content by name, and the features it uses."""

    content: str
    features: frozenset[str]

    def __str__(self) -> str:
        return "-".join([self.content, *sorted(self.features)])

    def of(self, kind: type[Any]) -> list[Any]:
        """Records of one kind, in file order."""
        return [record for record in CONTENTS[self.content] if isinstance(record, kind)]


def all_cases() -> Iterator[Case]:
    """Every sensible combination."""
    for content in CONTENTS:
        for features in chain.from_iterable(combinations(FEATURES, n) for n in range(len(FEATURES) + 1)):
            case = Case(content, frozenset(features))
            if _is_sensible(case):
                yield case


def _is_sensible(case: Case) -> bool:
    if not all(case.of(kind) for feature, kind in _NEEDED.items() if feature in case.features):
        return False
    if {"UseMessageIndex", "UseChunkIndex"} & case.features and "UseChunks" not in case.features:
        return False
    return "UseSummaryOffset" not in case.features or bool(_IN_SUMMARY & case.features)


def encoded(record: records.McapRecord, extra: bytes = b"") -> bytes:
    """A record as bytes, followed by unknown fields of its kind where the format allows them."""
    builder = RecordBuilder()
    record.write(builder)
    data = builder.end()
    if isinstance(record, _FIXED):
        return data
    return data[:1] + struct.pack("<Q", len(data) - 9 + len(extra)) + data[9:] + extra


def file_of(case: Case, compression: str = "", packed: Any = bytes) -> bytes:
    """The bytes of a file; `packed` compresses a chunk's records for another compression than none."""
    extra = _EXTRA if "AddExtraDataToRecords" in case.features else b""
    data = MAGIC + encoded(records.Header("", ""), extra)
    indexes: list[records.McapRecord] = []
    inside = b""
    entries: list[tuple[int, int]] = []
    for record in CONTENTS[case.content]:
        in_chunk = "UseChunks" in case.features and isinstance(record, _OF_CHUNKS)
        part = encoded(record, b"" if in_chunk else extra)
        if isinstance(record, records.Attachment):
            if "UseAttachmentIndex" in case.features:
                times = record.log_time, record.create_time
                size = len(record.data)
                index = records.AttachmentIndex(len(data), len(part), *times, size, record.name, record.media_type)
                indexes.append(index)
            data += part
        elif isinstance(record, records.Metadata):
            if "UseMetadataIndex" in case.features:
                indexes.append(records.MetadataIndex(len(data), len(part), record.name))
            data += part
        elif in_chunk:
            if isinstance(record, records.Message):
                entries.append((record.log_time, len(inside)))
            inside += part
        else:
            data += part
    if "UseChunks" in case.features:
        times = [time for time, _ in entries]
        content = packed(inside)
        sizes = len(inside), zlib.crc32(inside)
        chunk = encoded(records.Chunk(compression, content, max(times), min(times), sizes[1], sizes[0]))
        start, data = len(data), data + chunk
        offsets, behind = {}, b""
        if "UseMessageIndex" in case.features:
            offsets = {1: len(data)}
            behind = encoded(records.MessageIndex(1, entries), extra)
        data += behind
        if "UseChunkIndex" in case.features:
            span = max(times), len(behind), offsets, min(times)
            indexes.append(records.ChunkIndex(len(chunk), start, compression, len(content), *span, len(inside)))
    data += encoded(records.DataEnd(zlib.crc32(data)))
    return data + _summary(case, len(data), indexes, extra) + MAGIC


def _summary(case: Case, start: int, indexes: list[records.McapRecord], extra: bytes) -> bytes:
    groups: list[Iterable[records.McapRecord]] = [
        case.of(records.Schema) if "UseRepeatedSchemas" in case.features else [],
        case.of(records.Channel) if "UseRepeatedChannelInfos" in case.features else [],
        [_statistics(case)] if "UseStatistics" in case.features else [],
        indexes,
    ]
    summary, offsets = b"", b""
    for group in groups:
        part = b"".join(encoded(record, extra) for record in group)
        if part and "UseSummaryOffset" in case.features:
            place = records.SummaryOffset(Opcode(part[0]), start + len(summary), len(part))
            offsets += encoded(place, extra)
        summary += part
    body = summary + offsets
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start if summary else 0, start + len(summary) if offsets else 0)
    return body + head + struct.pack("<I", zlib.crc32(body + head))


def _statistics(case: Case) -> records.Statistics:
    times = [message.log_time for message in case.of(records.Message)] or [0]
    messages = len(case.of(records.Message))
    return records.Statistics(
        attachment_count=len(case.of(records.Attachment)),
        channel_count=len(case.of(records.Channel)),
        channel_message_counts={1: messages} if messages else {},
        chunk_count=int("UseChunks" in case.features),
        message_count=messages,
        message_end_time=max(times),
        message_start_time=min(times),
        metadata_count=len(case.of(records.Metadata)),
        schema_count=len(case.of(records.Schema)),
    )
