"""Contents of an MCAP file, here from its summary; daq.mcap.reader walks the whole file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from daq.mcap.chunks import ChunkTable
from daq.mcap.file_bytes import FileBytes
from daq.mcap.missing import Missing
from daq.mcap.records import AttachmentPlace, DamageError, Definitions, Facts, Header, read_metadata
from daq.mcap.summary_reader import FileSummary
from daq.mcap.writer import TIMES


@dataclass
class Contents:
    """Contents of a file.

    Attributes:
        header: program that wrote the file.
        table: its chunks.
        indexed: True if the table is from the summary and no chunk has been read yet.
        definitions: schemas and channels by id.
        counts: number of messages by channel id.
        span_ns: first and last log time; zeros for a file without messages.
        facts: the metadata records, in file order.
        attachments: positions of the attachments; not verified if `indexed`.
        missing: missing and damaged parts.
        unchecked: parts for which another writer stored no CRC.
    """

    header: Header
    table: ChunkTable
    indexed: bool
    definitions: Definitions
    counts: dict[int, int]
    span_ns: tuple[int, int]
    facts: list[Facts] = field(default_factory=list[Facts])
    attachments: list[AttachmentPlace] = field(default_factory=list[AttachmentPlace])
    missing: list[Missing] = field(default_factory=list[Missing])
    unchecked: list[Missing] = field(default_factory=list[Missing])

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Texts by name of record; of several records of a name the last one."""
        return {record.name: record.texts for record in self.facts}


def from_summary(file: FileBytes, header: Header, summary: FileSummary) -> Contents:
    """Return the contents according to an intact summary; no chunk and no attachment is read."""
    statistics = summary.statistics
    counts = {channel: n for channel, n in statistics.channel_message_counts.items() if n}
    span = (statistics.message_start_time, statistics.message_end_time) if counts else (0, 0)
    contents = Contents(header, summary.table, True, summary.definitions, counts, span)
    contents.attachments = [AttachmentPlace(index.offset, index.length, index.name) for index in summary.attachments]
    for index in summary.metadata:
        try:
            record = read_metadata(file, index.offset, header.ours)
            if record.name != index.name:
                raise DamageError(f"metadata {record.name[:80]!r} where {index.name[:80]!r} was expected")
            contents.facts.append(record)
        except DamageError as damage:
            end = index.offset + index.length
            text = f"{damage}: metadata {index.name[:80]!r} was left out"
            contents.missing.append(Missing(text, index.offset, end, messages=0))
    for record in contents.facts:
        if is_times(record):
            contents.table = bounded(summary.table, record.texts)
    contents.facts = [record for record in contents.facts if not is_times(record)]
    return contents


def is_times(record: Facts) -> bool:
    """Return True for the metadata record that contains the extreme delays of the samples."""
    return record.name == TIMES and record.texts.keys() == {"most_late_ns", "most_early_ns"}


def bounded(table: ChunkTable, times: Mapping[str, str]) -> ChunkTable:
    """Return the table with bounds of the sample times, from the extreme delays; unchanged if these are unknown."""
    try:
        late, early = int(times["most_late_ns"]), int(times["most_early_ns"])
    except (KeyError, ValueError):  # usual: files of other writers lack these times
        return table
    if not 0 <= late < 2**62 or not 0 <= early < 2**62 or (len(table) and table.end_ns.max() >= 2**62):
        return table
    return replace(table, low_ns=table.start_ns - np.int64(late), high_ns=table.end_ns + np.int64(early))
