"""Recovery of a cut or damaged log: a new, complete file with all intact contents of the old one.

Intact chunks are copied byte for byte and indexed again. Intact metadata and attachments are copied. The metadata
record "recovered" of the new file states its source and what is missing. The old file is only read, and no file is
overwritten.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap import records

from daq.errors import LogError, RecordingError
from daq.log import Log
from daq.log.columns import find_messages
from daq.log.file import give_name
from daq.log.lost_before import RECOVERED, lost_metadata, read_lost
from daq.log.source import LogSource
from daq.mcap.chunks import HEAD_BYTES, parse_head
from daq.mcap.missing import Missing
from daq.mcap.records import DamageError, read_attachment
from daq.mcap.writer import LIBRARY, BlockWriter, CopiedChunk
from daq.version import software_version
from rig_basics.ignoring import ignoring
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

_EARLIER = "recovered earlier"
_SUFFIX = ".recovering"
_ELSEWHERE = "Give another place for the new log"
_WALK_SHARE = 0.6  # share of the total time that the check of the old file takes


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery.

    Attributes:
        path: the new file.
        messages, chunks: numbers of messages and chunks in it.
        missing: what the old file lacked, place by place.
        seconds: time from the first to the last log time in it, s.
    """

    path: Path
    messages: int
    chunks: int
    missing: tuple[Missing, ...]
    seconds: float


def recover(part: Path, out: Path | None = None, progress: Callable[[float], None] | None = None) -> Recovered:
    """Write a new log with the intact contents of a cut or damaged one.

    A file that a recorder is still writing is copied up to its present end, but only to an explicitly given name:
    NAME.mcap is reserved for the recorder. If the file grew meanwhile, an item of `missing` states it.

    Args:
        part: the old file; it is not modified.
        out: the new file, NAME.mcap; its folder is created if necessary. Default: NAME.mcap for NAME.mcap.part,
            NAME.recovered.mcap for any other file.
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the old file is not a log or has no intact contents, it is still being written and the new file would
            have the recorder's name, or the new file exists already or does not end in .mcap.
        RecordingError: the new file cannot be written.
    """
    part = Path(part)
    out = _default_name(part) if out is None else Path(out)
    made = out.with_name(out.name + _SUFFIX)
    for path in (out, made):
        if path.exists():
            raise LogError(f"{path}: exists already; logs are never overwritten. Move it away or give another name")
    if out.suffix != ".mcap":
        raise LogError(f"{out}: expected a name for the new log that ends in .mcap, got {out.name!r}")
    report_share: Callable[[float], None] = progress or (lambda _: None)
    try:
        source = LogSource(part, lambda share: report_share(_WALK_SHARE * share))
    except OSError as fault:
        raise LogError(f"{part}: expected a log, cannot read it ({fault.strerror}): check the path") from fault
    except LogError as fault:
        raise LogError(f"{part}: {fault}; nothing can be recovered") from fault
    with contextlib.closing(source):
        found = source.contents
        if not (found.counts or found.metadata or found.attachments):
            raise LogError(f"{part}: expected a message, a fact or an attachment, found none; nothing can be recovered")
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            kept = _write(source, made, report_share)
            if out.absolute() == _default_name(part).absolute():
                _refuse_growing(source, out)
            give_name(made, out)
        except OSError as fault:
            _remove(made)
            todo = "The disk is full: make room or give another place" if fault.errno == errno.ENOSPC else _ELSEWHERE
            raise RecordingError(f"{out}: cannot be written ({fault}). {todo}. Nothing was changed") from fault
        except BaseException:
            _remove(made)
            raise
    report_share(1.0)
    return replace(kept, path=out)


def _remove(made: Path) -> None:
    """Remove an incomplete file if it exists."""
    with ignoring(_log, f"removing {made}", OSError):
        made.unlink()


def _default_name(part: Path) -> Path:
    return part.with_suffix("") if part.name.endswith(".mcap.part") else part.with_name(f"{part.stem}.recovered.mcap")


def _write(source: LogSource, made: Path, progress: Callable[[float], None]) -> Recovered:
    contents = source.contents
    header = contents.header
    with made.open("xb") as stream:
        writer = BlockWriter(stream, library=LIBRARY if header.ours else header.library)
        writer.start(header.profile)
        writer.adopt(*_definitions(source))
        _copy_metadata(source, writer)
        _copy_attachments(source, writer)
        chunks, messages = _copy_chunks(
            source, writer, lambda share: progress(_WALK_SHARE + 0.9 * share * (1 - _WALK_SHARE))
        )
        if contents.counts and not messages:
            raise LogError(f"{source.file.path}: expected at least one intact message, found none any more")
        missing = [*source.missing, *_growth(source)]
        writer.add_metadata(RECOVERED, _origin(source, missing, messages, chunks))
        if header.ours:
            writer.add_metadata("summary", contents.metadata.get("summary") or _summary(source))
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    start, end = contents.table.span()
    return Recovered(made, messages, chunks, tuple(missing), (end - start) / 1e9)


def _definitions(source: LogSource) -> tuple[list[records.Schema], list[records.Channel]]:
    """Return every definition the messages need; a channel without definition gets the topic "unknown/ID"."""
    known, counts = source.contents.definitions, source.contents.counts
    channels = dict(known.channels)
    for channel_id in set(counts) - set(channels):
        channels[channel_id] = records.Channel(channel_id, f"unknown/{channel_id}", "", {}, 0)
    for channel_id, channel in channels.items():
        if channel.schema_id not in known.schemas:
            channels[channel_id] = replace(channel, schema_id=0)
    schemas = [
        schema for schema in known.schemas.values() if schema.id
    ]  # 0 means "no schema", even if a file defines it
    return schemas, list(channels.values())


def _copy_metadata(source: LogSource, writer: BlockWriter) -> None:
    """Copy the intact metadata; those without a checksum of ours get none."""
    for name, texts, has_crc in source.contents.facts:
        if not source.contents.header.ours or name != "summary":
            writer.add_metadata(_EARLIER if name == RECOVERED else name, texts, has_crc)


def _copy_attachments(source: LogSource, writer: BlockWriter) -> None:
    for place in source.contents.attachments:
        try:
            found = read_attachment(source.file, place, source.contents.header.ours)
        except DamageError as damage:
            source.missing.append(Missing(str(damage), place.start, place.start + place.length, messages=0))
        else:
            writer.add_attachment(found.name, found.media_type, found.data, found.log_time, found.create_time)


def _copy_chunks(source: LogSource, writer: BlockWriter, progress: Callable[[float], None]) -> tuple[int, int]:
    """Copy every chunk that is still intact; return the numbers of chunks and messages."""
    table, chunks, messages = source.contents.table, 0, 0
    assert table.crc is not None  # `walk` has read all chunks
    everything = table.numbers(None)
    counts = table.messages(everything, range(65536))
    for chunk, data, _ in source.each(everything):
        found = find_messages(source, chunk, data, None, int(counts[chunk]))
        start, length = int(table.start[chunk]), int(table.length[chunk])
        packed, compression = data, ""
        if not table.bare[chunk]:
            record = source.file.read(start, length)
            head = parse_head(record[:HEAD_BYTES], length)
            packed, compression = record[head.data_at : head.data_at + head.packed], head.compression
        columns = found.channel_ids, found.log_ns, found.publish_ns, found.offsets
        writer.copy_chunk(CopiedChunk(packed, compression, len(data), int(table.crc[chunk]), *columns))
        chunks, messages = chunks + 1, messages + len(found)
        progress((start + length) / source.file.size)
    return chunks, messages


def _refuse_growing(source: LogSource, out: Path) -> None:
    """Raise if the recorder still writes the file and will need the new file's name.

    Raises:
        LogError: the file has grown since it was opened.
    """
    if _growth(source):
        raise LogError(
            f"{source.file.path}: is still being written, and its recorder will name it {out.name} at its end. End the "
            "recording, or give another name for what there is by now"
        )


def _growth(source: LogSource) -> list[Missing]:
    """Return the growth of the old file since it was opened, which shows that it is still being written."""
    grown = os.stat(source.file.path).st_size - source.file.size
    if grown <= 0:
        return []
    text = (
        f"the file was still being written: it grew by {number_of(grown, 'byte')} meanwhile, which the recovered log "
        f"does not contain"
    )
    return [Missing(text, source.file.size, source.file.size + grown)]


def _origin(source: LogSource, missing: list[Missing], messages: int, chunks: int) -> dict[str, str]:
    kept = int(source.contents.table.length.sum())
    return {
        "origin": source.file.path.name,
        "origin_bytes": str(source.file.size),
        "kept_chunk_bytes": str(kept),
        "kept_messages": str(messages),
        "kept_chunks": str(chunks),
        "missing_messages": "unknown"
        if any(place.messages is None for place in missing)
        else str(sum(place.messages or 0 for place in missing)),
        "missing_places": str(len(missing)),
        **lost_metadata(missing, source.file.path.name, read_lost(source.contents.metadata)),
        "origin_library": source.contents.header.library,
        "software": software_version(),
    }


def _summary(source: LogSource) -> Mapping[str, str]:
    """Return the summary in place of the recorder's: losses of the last report, and how the log ended."""
    facts: dict[str, Any] = {"ended": "cut; recovered"}
    try:
        reports = [note["losses"] for note in Log(source.file.path, source).health if "losses" in note]
        if reports:
            facts["losses"] = reports[-1]
    except LogError as fault:
        _log.warning("%s: its counts of losses are not in the recovered log: %s", source.file.path, fault)
    return {key: json.dumps(value) for key, value in facts.items()}
