"""Finds out what an MCAP file holds: finished, unfinished, cut and damaged files alike.

A sound summary tells at once; otherwise the file is walked from its start (daq.mcap.walk) and whatever is whole is
kept. Everything a damaged file lacks is said in `Contents.missing`; only a file that is no MCAP at all is an error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from daq.errors import LogError
from daq.log.samples import Missing
from daq.mcap.chunks import HEAD_BYTES, ChunkTable, parse_head
from daq.mcap.contents import Contents, from_summary
from daq.mcap.damage import topics_of
from daq.mcap.file_bytes import FileBytes
from daq.mcap.records import DamageError, Header, check_attachment, read_header
from daq.mcap.summary_reader import Summary, read_summary
from daq.mcap.walk import Walk
from daq.mcap.writer import TIMES

_SHORT_HEAD_BYTES = 64  # enough of a chunk's record for the head of one that can be unpacked


def survey(file: FileBytes) -> Contents:
    """Find out what a file holds: at once from a sound summary, else by going through all of it.

    Raises:
        LogError: it does not begin like an MCAP file.
    """
    header = read_header(file)
    try:
        summary = read_summary(file, header)
        if not _only_index_knows(header, summary) and _stands_twice(file, summary.table):
            raise DamageError("the same chunk stands at two places of the index")
        return from_summary(file, header, summary)
    except DamageError:
        return walk(file)


def _only_index_knows(header: Header, summary: Summary) -> bool:
    """Whether nothing else tells if the same chunk twice was written so or copied by mistake: another writer, who need
    not number messages, and gave no CRC of the data.
    """
    return not header.ours and not summary.data_crc


def _stands_twice(file: FileBytes, index: ChunkTable) -> bool:
    """Whether two chunks of an index have the same CRC as well; a chunk that is not what its index says is found out
    when it is read.
    """
    for chunks in index.alike():
        crcs: set[int] = set()
        for start, length in zip(index.start[chunks].tolist(), index.length[chunks].tolist(), strict=True):
            try:
                crc = parse_head(file.read(start, min(length, _SHORT_HEAD_BYTES)), length).crc
            except (DamageError, LogError):
                continue
            if crc in crcs:
                return True
            crcs.add(crc)
    return False


def walk(file: FileBytes, progress: Callable[[float], None] | None = None) -> Contents:
    """Go through a whole file and check everything in it; a sound summary tells what the damaged places held.

    Args:
        file: the file.
        progress: told now and then which share of it is done.

    Raises:
        LogError: it does not begin like an MCAP file.
    """
    header = read_header(file)
    try:
        summary, why = read_summary(file, header), ""
    except DamageError as damage:
        summary, why = None, str(damage)
    believed = frozenset[int]()
    if summary is not None and _only_index_knows(header, summary):
        believed = frozenset(summary.table.start.tolist())
    done = Walk(file, header, why, believed, progress)
    done.run()
    if not done.finished:
        _note_cut(done)
    if summary is not None:
        _use_summary(done, summary)
    table = done.table.build()
    if summary is None:
        done.damage.settle(table, done.unnamed)
    done.metadata.pop(TIMES, None)  # the table has the times themselves
    contents = Contents(
        header,
        table,
        False,
        done.definitions,
        table.totals(),
        table.span(),
        done.metadata,
        done.attachments,
    )
    contents.missing = _missing(done, summary, contents)
    contents.unchecked = [
        Missing(f"{count} {what} without a CRC: damage in them cannot be seen", messages=0)
        for what, count in done.no_crc.items()
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


def _use_summary(done: Walk, summary: Summary) -> None:
    """Take what only the summary leads to, because it stands in a damaged stretch, and compare it with the rest."""
    done.definitions.fill_up(summary.definitions)
    found = from_summary(done.file, done.header, summary)
    done.metadata = found.metadata  # the index knows the names, which no CRC of the records covers
    for place in found.missing:
        done.damage.note(place.byte_start or 0, place.byte_end or 0, place.text, len(done.table))
    known = {place.start for place in done.attachments}
    for place in found.attachments:
        if place.start not in known:
            try:
                done.attachments.append(check_attachment(done.file, place.start, done.header.ours))
            except DamageError as damage:
                text, end = f"{damage}: attachment {place.name[:80]!r} was left out", place.start + place.length
                done.damage.note(place.start, end, text, len(done.table))
    starts = set(done.table.starts)
    for start, length in zip(summary.table.start.tolist(), summary.table.length.tolist(), strict=True):
        if start not in starts:
            try:
                head = parse_head(done.window.view(start, min(start + length, start + HEAD_BYTES)), length)
                done.table.add(start, head, done.read_chunk(start, start + length, head))
            except DamageError:
                continue  # the walk has noted it
    table = done.table.build()
    done.damage.explain(summary.table, table)
    if not done.damage.places and not _same(table, summary.table):
        text = "the index is not what stands in the file"
        done.damage.note(summary.data_end, done.file.size, text, len(table)).held = []


def _same(table: ChunkTable, index: ChunkTable) -> bool:
    """Everything that both know of the chunks agrees."""
    filled = table.first_entry[1:] > table.first_entry[:-1]
    return (
        np.array_equal(table.start, index.start)
        and np.array_equal(table.unpacked, index.unpacked)
        and np.array_equal(table.start_ns[filled], index.start_ns[filled])
        and np.array_equal(table.end_ns[filled], index.end_ns[filled])
        and table.totals() == index.totals()
    )


def _missing(done: Walk, summary: Summary | None, contents: Contents) -> list[Missing]:
    """What is missing, in file order; counts that only the statistics tell go where they must belong."""
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
            missing.append(Missing(f"the statistics count {done.announced} messages", messages=lost))
    for channel in sorted(set(contents.counts) - set(contents.definitions.channels)):
        text = f"the name of channel {channel}, so all its messages"
        topics = topics_of({channel: 0}, contents.definitions)
        missing.append(Missing(text, topics=topics, messages=contents.counts[channel]))
    return missing
