"""Table of chunks, built while a file is walked."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.mcap.checksum import crc32
from daq.mcap.chunks import EVER_NS, ChunkHead, ChunkTable
from daq.mcap.records import RECORD_HEAD, DamageError, Definitions
from daq.mcap.scan import definitions, locate, tally

_NOTHING = np.empty(0, np.uint8)


@dataclass(frozen=True)
class TakenChunk:
    """An intact chunk: records, uint8; messages by channel id; first and last log and publish times, ns."""

    data: NDArray[np.uint8]
    counts: dict[int, int]
    times: list[int]


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
        self._counts, self._touched = np.zeros(65536, np.int64), np.empty(65536, np.int64)
        self._times = np.empty(4, np.uint64)
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
        return self._rows[::10].tolist()

    def count(self, data: NDArray[np.uint8]) -> TakenChunk:
        """Count the messages of an unpacked chunk, and add its definitions to the known ones.

        Raises:
            DamageError: it does not consist of whole records, or redefines an id.
        """
        found, others = tally(data, self._counts, self._touched, self._times)
        if found < 0:
            self._counts[:] = 0
            raise DamageError("a chunk that does not consist of whole records")
        ids = self._touched[:found]
        counts = dict(zip(ids.tolist(), self._counts[ids].tolist(), strict=True))
        self._counts[ids] = 0
        if others:
            places = np.empty((others, 2), np.int64)
            for start, end in places[: definitions(data, places)].tolist():
                self._known.take(int(data[start]), data[start + RECORD_HEAD.size : end].tobytes())
        return TakenChunk(data, counts, self._times.tolist() if found else [0] * 4)

    def add(self, start: int, head: ChunkHead, chunk: TakenChunk, trusted: bool = False) -> int | None:
        """Add a chunk that begins at byte `start`. A duplicate is not added; the position of the first is returned.

        Args:
            trusted: add a duplicate as well.
        """
        crc = head.crc or crc32(chunk.data.data)
        key = crc, head.unpacked, *chunk.times
        earlier = self._seen.setdefault(key, start)
        if earlier != start and chunk.counts and not trusted:
            self._copies.append((start, replace(head, crc=crc), replace(chunk, data=_NOTHING)))
            return earlier
        self._rows.extend((start, head.data_at + head.packed, head.packed, head.unpacked, head.kind, crc))
        self._rows.extend(min(time, EVER_NS) for time in chunk.times)
        if max(chunk.times) > EVER_NS:
            self.beyond += _beyond(chunk)
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
        rows = np.array(self._rows, np.int64).reshape(-1, 10)
        entries = np.array(self._entries, np.int64).reshape(-1, 2)
        first_entry = np.array(self._first_entry, np.int64)
        if (np.diff(rows[:, 0]) < 0).any():  # some were found later
            order = np.argsort(rows[:, 0])
            sizes = np.diff(first_entry)[order]
            begins = np.repeat(first_entry[:-1][order] - np.cumsum(sizes) + sizes, sizes)
            entries = entries[begins + np.arange(len(begins))]
            rows, first_entry = rows[order], np.concatenate([[0], np.cumsum(sizes)])
        start, length, packed, unpacked, kind, crc, first_log, last_log, first_publish, last_publish = (
            np.ascontiguousarray(column) for column in rows.T
        )
        return ChunkTable(
            start,
            length,
            packed,
            unpacked,
            kind.astype(np.uint8),
            first_log,
            last_log,
            np.minimum(first_log, first_publish),
            np.maximum(last_log, last_publish),
            crc.astype(np.uint32),
            first_entry,
            entries[:, 0].astype(np.uint16),
            entries[:, 1].astype(np.uint32),
        )


def _beyond(chunk: TakenChunk) -> int:
    """Return the number of messages whose log time or publish time a signed number of 64 bits does not hold."""
    count = sum(chunk.counts.values())
    log_times, publish_times = np.empty(count, np.int64), np.empty(count, np.int64)
    locate(chunk.data, np.empty(0, np.int64), np.empty((count, 3), np.int64), log_times, publish_times)
    return int(np.count_nonzero((log_times < 0) | (publish_times < 0)))
