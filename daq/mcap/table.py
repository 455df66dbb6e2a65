"""Table of chunks, built while a file is walked."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace

import numpy as np

from daq.mcap.checksum import crc32
from daq.mcap.chunks import EVER_NS, ChunkHead, ChunkTable
from daq.mcap.records import Definitions
from daq.mcap.scan import Messages, split_chunk


@dataclass(frozen=True)
class TakenChunk:
    """An intact chunk: CRC of its records; messages by channel id; first and last log and publish times, ns.

    Attributes:
        beyond: number of messages with a time that a signed number of 64 bits does not hold.
        messages: its messages; None if they are not needed any more.
    """

    crc: int
    counts: dict[int, int]
    times: tuple[int, ...]
    beyond: int
    messages: Messages | None


class TableBuilder:
    """Builder of a `ChunkTable`.

    Args:
        known: receives the schemas and channels found in the chunks.

    Attributes:
        beyond: number of messages with a time that a signed number of 64 bits does not hold.
    """

    def __init__(self, known: Definitions) -> None:
        self._known = known
        self.beyond: int = 0
        self._rows = array("q")
        self._entries = array("q")
        self._first_entry = array("q", [0])
        self._seen: dict[tuple[int, ...], int] = {}  # CRC, size and times of a chunk: its position
        self._copies: list[tuple[int, ChunkHead, TakenChunk]] = []

    def __len__(self) -> int:
        return len(self._first_entry) - 1

    @property
    def starts(self) -> list[int]:
        """Positions of the chunks so far, bytes."""
        return self._rows[::9].tolist()

    def count(self, data: bytes) -> TakenChunk:
        """Count the messages of an unpacked chunk, and add its definitions to the known ones.

        Raises:
            DamageError: it does not consist of whole records, or redefines an id.
        """
        messages, definitions = split_chunk(data)
        for opcode, body in definitions:
            self._known.take(opcode, body)
        columns = messages.log_ns, messages.publish_ns
        times = (
            tuple(int(pick(column)) for column in columns for pick in (np.min, np.max)) if len(messages) else (0,) * 4
        )
        beyond = 0
        if max(times) > EVER_NS:
            beyond = int(np.count_nonzero((columns[0] > EVER_NS) | (columns[1] > EVER_NS)))
        return TakenChunk(crc32(data), messages.counts, times, beyond, messages)

    def add(self, start: int, head: ChunkHead, chunk: TakenChunk, trusted: bool = False) -> int | None:
        """Add a chunk that begins at byte `start`. A duplicate is not added; the position of the first is returned.

        Args:
            trusted: add a duplicate as well. Other writers need not number messages, and may write some twice.
        """
        earlier = self._seen.setdefault((chunk.crc, head.unpacked, *chunk.times), start)
        if earlier != start and chunk.counts and not trusted:
            self._copies.append((start, head, replace(chunk, messages=None)))
            return earlier
        self._rows.extend((start, head.data_at + head.packed, head.unpacked, head.data_at == 0, chunk.crc))
        self._rows.extend(min(time, EVER_NS) for time in chunk.times)
        self.beyond += chunk.beyond
        for pair in chunk.counts.items():
            self._entries.extend(pair)
        self._first_entry.append(len(self._entries) // 2)
        return None

    def keep_all(self) -> set[int]:
        """Add the omitted duplicates; return their positions."""
        for start, head, chunk in self._copies:
            self.add(start, head, chunk, trusted=True)
        return {start for start, _, _ in self._copies}

    def build(self) -> ChunkTable:
        """Return the table of all chunks so far."""
        rows = np.array(self._rows, np.int64).reshape(-1, 9)
        entries = np.array(self._entries, np.int64).reshape(-1, 2)
        first_entry = np.array(self._first_entry, np.int64)
        if (np.diff(rows[:, 0]) < 0).any():  # some were found later
            sorted_rows = np.argsort(rows[:, 0])
            sizes = np.diff(first_entry)[sorted_rows]
            begins = np.repeat(first_entry[:-1][sorted_rows] - np.cumsum(sizes) + sizes, sizes)
            entries = entries[begins + np.arange(len(begins))]
            rows, first_entry = rows[sorted_rows], np.concatenate([[0], np.cumsum(sizes)])
        start, length, unpacked, bare, crc, first_log, last_log, first_publish, last_publish = (
            np.ascontiguousarray(column) for column in rows.T
        )
        return ChunkTable(
            start,
            length,
            unpacked,
            bare.astype(bool),
            first_log,
            last_log,
            np.minimum(first_log, first_publish),
            np.maximum(last_log, last_publish),
            crc.astype(np.uint32),
            first_entry,
            entries[:, 0].astype(np.uint16),
            entries[:, 1],
            np.full(len(entries), -1),
        )
