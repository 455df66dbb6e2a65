"""Contents of an MCAP file that is finished, unfinished, cut or damaged.

An intact summary lists the contents. Otherwise the file is walked from its start (daq.mcap.walk) and everything intact
is used. Missing and damaged parts are listed in `Contents.missing`; only a file that is not MCAP raises an error.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from daq.errors import LogError
from daq.mcap.chunks import EVER_NS, HEAD_BYTES, ChunkTable, parse_head
from daq.mcap.contents import Contents, from_summary, is_times
from daq.mcap.damage import topics_of
from daq.mcap.file_bytes import FileBytes
from daq.mcap.missing import Missing
from daq.mcap.records import DamageError, check_attachment, read_header
from daq.mcap.summary_reader import FileSummary, read_summary
from daq.mcap.walk import Walk
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)
_PLURALS = {"series of messages": "series of messages", "summary": "summaries"}

_SHORT_HEAD_BYTES = 64  # contains the head of any chunk that can be unpacked


def survey(file: FileBytes) -> Contents:
    """Determine the contents of a file from an intact summary, otherwise by reading the whole file.

    Raises:
        LogError: the file does not begin like an MCAP file.
    """
    header = read_header(file)
    try:
        summary = read_summary(file)
        if header.ours and _has_duplicates(file, summary.table):
            raise DamageError("the same chunk is at two places of the index")
        if summary.statistics.message_end_time > EVER_NS:
            raise DamageError(f"a log time of {summary.statistics.message_end_time} ns")  # the walk counts such times
        return from_summary(file, header, summary)
    except DamageError as damage:
        _log.info("%s: the whole file is read, since its summary cannot be used: %s", file.path, damage)
        return walk(file)


def _has_duplicates(file: FileBytes, index: ChunkTable) -> bool:
    """Return True if two similar chunks of an index also have the same CRC.

    A chunk that does not match its index is detected when it is read.
    """
    for chunks in index.alike():
        crcs: set[int] = set()
        for start, length in zip(index.start[chunks].tolist(), index.length[chunks].tolist(), strict=True):
            try:
                crc = parse_head(file.read(start, min(length, _SHORT_HEAD_BYTES)), length).crc
            except (DamageError, LogError):  # usual: the damage is found when the chunk is read
                continue
            if crc in crcs:
                return True
            crcs.add(crc)
    return False


def walk(file: FileBytes, progress: Callable[[float], None] | None = None) -> Contents:
    """Read a whole file and check everything in it; an intact summary gives the former contents of damaged places.

    Args:
        file: the open file.
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the file does not begin like an MCAP file.
    """
    header = read_header(file)
    try:
        summary, why = read_summary(file), ""
    except DamageError as damage:
        summary, why = None, str(damage)
    done = Walk(file, header, why, progress)
    done.run()
    if not done.finished:
        _note_cut(done)
    if summary is not None:
        _use_summary(done, summary)
    table = done.table.build()
    if summary is None:
        done.damage.settle(table, done.unnamed)
    contents = Contents(
        header,
        table,
        False,
        done.definitions,
        table.totals(),
        table.span(),
        [record for record in done.facts if not is_times(record)],  # the table contains the times themselves
        done.attachments,
    )
    contents.missing = _missing(done, summary, contents)
    if done.table.beyond:
        text = (
            f"{number_of(done.table.beyond, 'message')} with times of 2^63 ns or more, after the year 2262: "
            f"their times are wrong"
        )
        contents.missing.append(Missing(text, messages=0))
    without_crc = (number_of(count, what, _PLURALS.get(what, "")) for what, count in done.no_crc.items())
    contents.unchecked = [
        Missing(f"{counted} without a CRC: damage in them cannot be detected", messages=0) for counted in without_crc
    ]
    return contents


def _note_cut(done: Walk) -> None:
    places = done.damage.places
    if done.budget <= 0:
        text = "so much is damaged that the rest was not searched"
        done.damage.note(done.position, done.file.size, text, len(done.table))
    elif places and places[-1].end >= done.file.size and places[-1].held is None:
        places[-1].text = f"the file was not finished or is cut: {places[-1].text}"
    else:
        text = "the file was not finished or is cut: no footer at its end"
        done.damage.note(done.position, done.file.size, text, len(done.table))


def _use_summary(done: Walk, summary: FileSummary) -> None:
    """Add what only the summary locates, because it is in a damaged range, and compare the summary with the rest."""
    done.definitions.fill_up(summary.definitions)
    found = from_summary(done.file, done.header, summary)
    done.facts = found.facts  # the index contains the names, which no CRC of the records covers
    for place in found.missing:
        done.damage.note(place.byte_start or 0, place.byte_end or 0, place.text, len(done.table))
    starts_found = {place.start for place in done.attachments}
    for place in found.attachments:
        if place.start not in starts_found:
            try:
                done.attachments.append(check_attachment(done.file, place.start, done.header.ours)[0])
            except DamageError as damage:
                text, end = f"{damage}: attachment {place.name[:80]!r} was left out", place.start + place.length
                done.damage.note(place.start, end, text, len(done.table))
    starts = set(done.table.starts)
    for start, length in zip(summary.table.start.tolist(), summary.table.length.tolist(), strict=True):
        if start not in starts:
            try:
                head = parse_head(done.window.view(start, min(start + length, start + HEAD_BYTES)), length)
                done.table.add(start, head, done.read_chunk(start, start + length, head))
            except DamageError:  # usual: `Walk` has listed the chunk
                continue
    table = done.table.build()
    done.damage.explain(summary.table, table)
    if not done.damage.places and not _same(table, summary.table):
        text = "the index does not match the file"
        done.damage.note(summary.data_end, done.file.size, text, len(table)).held = []


def _same(table: ChunkTable, index: ChunkTable) -> bool:
    """Return True if all facts of the chunks that both tables contain agree."""
    filled = table.first_entry[1:] > table.first_entry[:-1]
    return (
        np.array_equal(table.start, index.start)
        and np.array_equal(table.unpacked, index.unpacked)
        and np.array_equal(table.start_ns[filled], index.start_ns[filled])
        and np.array_equal(table.end_ns[filled], index.end_ns[filled])
        and table.totals() == index.totals()
    )


def _missing(done: Walk, summary: FileSummary | None, contents: Contents) -> list[Missing]:
    """Return what is missing, in file order; messages counted only by the statistics are assigned where possible."""
    missing = done.damage.missing(contents.definitions, contents.table)
    if done.announced is not None and summary is None:
        lost = done.announced - sum(contents.counts.values())
        if lost == 0:
            missing = [replace(place, topics=(), messages=0, start_ns=None, end_ns=None) for place in missing]
        unknown = [number for number, place in enumerate(missing) if place.messages is None]
        lost -= sum(place.messages or 0 for place in missing)
        if lost > 0 and len(unknown) == 1:
            missing[unknown[0]] = replace(missing[unknown[0]], messages=lost)
        elif lost > 0:
            missing.append(Missing(f"the statistics count {number_of(done.announced, 'message')}", messages=lost))
    for channel in sorted(set(contents.counts) - set(contents.definitions.channels)):
        text = f"the name of channel {channel}, so all its messages"
        topics = topics_of({channel: 0}, contents.definitions)
        missing.append(Missing(text, topics=topics, messages=contents.counts[channel]))
    return missing
