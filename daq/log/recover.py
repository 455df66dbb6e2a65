"""A log that was cut or damaged made whole: a new file of everything in the old one that is sound.

Good chunks are copied byte for byte and get fresh indexes; good metadata and attachments go along. The new file says
in its metadata "recovered" where it comes from and what is missing. The old file is only read, and no file is ever
written over.
"""

from __future__ import annotations

import contextlib
import errno
import json
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
from daq.log.lost_before import RECOVERED, read_lost, tell_lost
from daq.log.samples import Missing
from daq.log.source import LogSource
from daq.mcap.chunks import BARE, HEAD_BYTES, parse_head
from daq.mcap.records import DamageError, read_attachment
from daq.mcap.writer import METADATA_CRC, BlockWriter
from daq.version import software_version

_EARLIER = "recovered earlier"
_SUFFIX = ".recovering"
_ELSEWHERE = "Give another place with -o"
_COPYING_FROM = 0.6  # share of the time after which everything is checked


@dataclass(frozen=True)
class Recovered:
    """What was saved of a log.

    Attributes:
        path: the new file.
        messages, chunks: how many are in it.
        missing: what the old file lacked, place by place.
        seconds: from the first to the last log time in it.
    """

    path: Path
    messages: int
    chunks: int
    missing: tuple[Missing, ...]
    seconds: float


def recover(part: Path, out: Path | None = None, progress: Callable[[float], None] | None = None) -> Recovered:
    """Make a whole log of what is sound in a cut or damaged one.

    A file that a recorder is still writing is taken as far as it goes, but only under a name given for it: NAME.mcap
    will be the recorder's own. That it grew meanwhile is said among what is missing.

    Args:
        part: the old file; it is not touched.
        out: the new file, NAME.mcap; its folder is made where there is none. Without it NAME.mcap for NAME.mcap.part,
            NAME.recovered.mcap for anything else.
        progress: told now and then which share is done.

    Raises:
        LogError: no log, nothing in it can be saved, it is still being written and the new file would have the
            recorder's name, or the new file exists already or is no .mcap.
        RecordingError: the new file cannot be written.
    """
    part = Path(part)
    out = _default_name(part) if out is None else Path(out)
    made = out.with_name(out.name + _SUFFIX)
    for path in (out, made):
        if path.exists():
            raise LogError(f"{path}: exists already; a log is never written over. Move it away or give another name")
    if out.suffix != ".mcap":
        raise LogError(f"{out}: expected a name for the new log that ends in .mcap, got {out.name!r}")
    tell = progress or (lambda _: None)
    try:
        source = LogSource(part, lambda share: tell(_COPYING_FROM * share))
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
            kept = _write(source, made, tell)
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
    tell(1.0)
    return replace(kept, path=out)


def _remove(made: Path) -> None:
    """Remove half a file, wherever one could be made."""
    with contextlib.suppress(OSError):
        made.unlink()


def _default_name(part: Path) -> Path:
    return part.with_suffix("") if part.name.endswith(".mcap.part") else part.with_name(f"{part.stem}.recovered.mcap")


def _write(source: LogSource, made: Path, tell: Callable[[float], None]) -> Recovered:
    contents = source.contents
    with made.open("xb") as stream:
        writer = BlockWriter(stream)
        writer.start()
        writer.adopt(*_definitions(source))
        facts, attachments = _other_records(source)
        for name, texts in facts.items():
            if name != "summary":
                writer.add_metadata(name, texts)
        for attachment in attachments:
            writer.add_attachment(attachment.name, attachment.media_type, attachment.data, attachment.log_time)
        chunks, messages = _copy_chunks(
            source, writer, lambda share: tell(_COPYING_FROM + 0.9 * share * (1 - _COPYING_FROM))
        )
        if contents.counts and not messages:
            raise LogError(f"{source.file.path}: expected at least one sound message, found none any more")
        missing = [*source.missing, *_growth(source)]
        writer.add_metadata(RECOVERED, _origin(source, missing, messages, chunks))
        if contents.header.ours or "summary" in facts:
            writer.add_metadata("summary", facts.get("summary") or _summary(source))
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    start, end = contents.table.span()
    return Recovered(made, messages, chunks, tuple(missing), (end - start) / 1e9)


def _definitions(source: LogSource) -> tuple[list[records.Schema], list[records.Channel]]:
    """Every definition the messages need; a channel whose own was lost is kept under a name that says so."""
    known, counts = source.contents.definitions, source.contents.counts
    channels = dict(known.channels)
    for channel_id in set(counts) - set(channels):
        channels[channel_id] = records.Channel(channel_id, f"unknown/{channel_id}", "", {}, 0)
    for channel_id, channel in channels.items():
        if channel.schema_id not in known.schemas:
            channels[channel_id] = replace(channel, schema_id=0)
    schemas = [schema for schema in known.schemas.values() if schema.id]  # 0 means none, whatever a file defines it as
    return schemas, list(channels.values())


def _other_records(source: LogSource) -> tuple[dict[str, dict[str, str]], list[records.Attachment]]:
    """Metadata and attachments that are sound, made fit for the new file."""
    facts: dict[str, dict[str, str]] = {}
    for name, texts in source.contents.metadata.items():
        own = {f"{key} of origin" if key == METADATA_CRC else key: text for key, text in texts.items()}
        facts[_EARLIER if name == RECOVERED else name] = own
    attachments: list[records.Attachment] = []
    for place in source.contents.attachments:
        try:
            attachments.append(read_attachment(source.file, place, source.contents.header.ours))
        except DamageError as damage:
            source.missing.append(Missing(str(damage), place.start, place.start + place.length, messages=0))
    return facts, attachments


def _copy_chunks(source: LogSource, writer: BlockWriter, tell: Callable[[float], None]) -> tuple[int, int]:
    """Copy every chunk that is still sound; returns how many chunks and messages."""
    table, chunks, messages = source.contents.table, 0, 0
    assert table.crc is not None  # a walk has read them all
    everything = table.numbers(None)
    counts = table.messages(everything, range(65536))
    for chunk, data in source.each(everything):
        found = find_messages(data, everything[:0], int(counts[chunk]))
        start, length = int(table.start[chunk]), int(table.length[chunk])
        packed, compression = data.tobytes(), ""
        if table.kind[chunk] != BARE:
            record = source.file.read(start, length)
            head = parse_head(record[:HEAD_BYTES], length)
            packed, compression = record[head.data_at :], head.compression
        crc = int(table.crc[chunk])
        ids = found.places[:, 2]
        writer.copy_chunk(packed, compression, len(data), crc, ids, found.log_ns, found.publish_ns, found.places[:, 0])
        chunks, messages = chunks + 1, messages + len(ids)
        tell((start + length) / source.file.size)
    return chunks, messages


def _refuse_growing(source: LogSource, out: Path) -> None:
    """Leave its name to a recorder that is still at work.

    Raises:
        LogError: the file has grown since it was opened.
    """
    if _growth(source):
        raise LogError(
            f"{source.file.path}: is still being written, and its recorder will name it {out.name} at its end. End the "
            "recording, or give another name with -o for what there is by now"
        )


def _growth(source: LogSource) -> list[Missing]:
    """That the old file became longer since it was opened: somebody still writes it."""
    grown = os.stat(source.file.path).st_size - source.file.size
    if grown <= 0:
        return []
    text = f"the file was still being written: it grew by {grown} bytes meanwhile, which are not in the recovered log"
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
        **tell_lost(missing, source.file.path.name, read_lost(source.contents.metadata)),
        "origin_library": source.contents.header.library,
        "software": software_version(),
    }


def _summary(source: LogSource) -> Mapping[str, str]:
    """What the recorder would have written at the end: losses as last reported, and how it ended."""
    facts: dict[str, Any] = {"ended": "cut; recovered"}
    with contextlib.suppress(LogError):
        reports = [note["losses"] for note in Log(source.file.path, source).health if "losses" in note]
        if reports:
            facts["losses"] = reports[-1]
    return {key: json.dumps(value) for key, value in facts.items()}
