"""Damaged places of a file, and what is known of their former contents."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.mcap.chunks import ChunkTable
from daq.mcap.missing import Missing
from daq.mcap.records import Definitions


@dataclass(frozen=True)
class Held:
    """Messages listed in an index: number by channel id, first and last log time, ns."""

    counts: dict[int, int]
    span_ns: tuple[int, int] | None


@dataclass
class Place:
    """A damaged range of a file.

    Attributes:
        start, end: range, bytes.
        text: description of the damage.
        before: number of intact chunks before it.
        held: known former contents; None if unknown, empty if it contained no message.
    """

    start: int
    end: int
    text: str
    before: int
    held: list[Held] | None = None


@dataclass
class FileDamage:
    """All damaged places of a file, in file order."""

    places: list[Place] = field(default_factory=list[Place])

    def note(self, start: int, end: int, text: str, before: int) -> Place:
        """Add a place."""
        self.places.append(Place(start, end, text, before))
        return self.places[-1]

    def explain(self, index: ChunkTable, found: ChunkTable) -> None:
        """Determine from an intact index which chunks were not found, and thus the contents of each place.

        A chunk that is not at its place may be at another one. Each chunk found at a place that is not in the index
        replaces one missing chunk.
        """
        by_start = sorted(self.places, key=lambda place: place.start)
        sorted_starts = [place.start for place in by_start]
        for place in self.places:
            place.held = []
        for chunk in _not_found(index, found):
            start, end = int(index.start[chunk]), int(index.start[chunk] + index.length[chunk])
            near = bisect_left(sorted_starts, end) - 1
            if near >= 0 and by_start[near].end > start:
                at = by_start[near]
            else:
                at = self.note(start, end, "a chunk of the index is missing", int((found.start < start).sum()))
            at.held = at.held or []
            at.held.append(Held(dict(index.entries(chunk)), (int(index.start_ns[chunk]), int(index.end_ns[chunk]))))
        self.places.sort(key=lambda place: place.start)

    def settle(self, found: ChunkTable, unnamed: set[int]) -> None:
        """Remove messages listed in message indexes whose chunks are elsewhere in the file and thus not missing.

        Args:
            found: intact chunks.
            unnamed: positions of intact chunks that lack message indexes of their own. If only other chunks match the
                listed messages, the indexes may belong to them or to a similar chunk that was lost. Then the contents
                are unknown.
        """
        free = {chunk for chunk, start in enumerate(found.start.tolist()) if start in unnamed}
        for place in self.places:
            left: list[Held] | None = []
            for held in place.held or ():
                alike = _alike(held, found)
                moved = next((chunk for chunk in alike if chunk in free), None)
                if moved is not None:
                    free.discard(moved)
                elif alike:
                    left = None
                elif left is not None and held.counts:
                    left.append(held)
            if place.held:
                place.held = left

    def missing(self, definitions: Definitions, table: ChunkTable) -> list[Missing]:
        """Return the places as `Missing`; if nothing else is known, the times are those of the neighbours."""
        return [_missing(place, definitions, table) for place in self.places]


def _not_found(index: ChunkTable, found: ChunkTable) -> list[int]:
    """Return the numbers of the index's chunks that were not found; each chunk found elsewhere replaces one."""
    as_listed, in_place = _pairs(index, found)
    spare: dict[tuple[object, ...], list[int]] = {}
    for number in np.flatnonzero(~in_place).tolist():
        spare.setdefault(_facts(found, number), []).append(number)
    lacking: list[int] = []
    for number in np.flatnonzero(~as_listed).tolist():
        if elsewhere := spare.get(_facts(index, number)):
            elsewhere.pop()
        else:
            lacking.append(number)
    # if the right messages are at the right place, the times in the index are wrong
    holding = {int(found.start[n]): _entries(found, n) for numbers in spare.values() for n in numbers}
    return [number for number in lacking if holding.get(int(index.start[number])) != _entries(index, number)]


def _pairs(index: ChunkTable, found: ChunkTable) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which chunks of the index were found at their place as listed, and which found chunks these are."""
    _, a, b = np.intersect1d(index.start, found.start, assume_unique=True, return_indices=True)
    listed, present = (table.messages(table.numbers(None), range(65536)) for table in (index, found))
    same = (listed[a] == present[b]) & (index.unpacked[a] == found.unpacked[b])
    same &= (listed[a] == 0) | ((index.start_ns[a] == found.start_ns[b]) & (index.end_ns[a] == found.end_ns[b]))
    as_listed, in_place = np.zeros(len(index), bool), np.zeros(len(found), bool)
    as_listed[a[same]] = in_place[b[same]] = True
    return as_listed, in_place


def _facts(table: ChunkTable, chunk: int) -> tuple[object, ...]:
    """Return the facts that are contained both in an index and in a chunk itself."""
    return int(table.start_ns[chunk]), int(table.end_ns[chunk]), int(table.unpacked[chunk]), _entries(table, chunk)


def _entries(table: ChunkTable, chunk: int) -> frozenset[tuple[int, int]]:
    return frozenset(table.entries(chunk))


def _alike(held: Held, found: ChunkTable) -> list[int]:
    """Return the chunks that contain at least these messages in this time span."""
    if held.span_ns is None:
        return []
    around = (found.start_ns <= held.span_ns[0]) & (found.end_ns >= held.span_ns[1])
    return [c for c in np.flatnonzero(around).tolist() if held.counts.items() <= dict(found.entries(c)).items()]


def _missing(place: Place, definitions: Definitions, table: ChunkTable) -> Missing:
    if place.held is not None:
        counts: Counter[int] = Counter()
        for held in place.held:
            counts.update(held.counts)
        spans = [held.span_ns for held in place.held if held.counts and held.span_ns]
        start, end = (min(span[0] for span in spans), max(span[1] for span in spans)) if spans else (None, None)
        topics = topics_of(counts, definitions)
        return Missing(place.text, place.start, place.end, start, end, topics, counts.total())
    before = int(table.end_ns[: place.before].max()) if place.before else None
    after = int(table.start_ns[place.before]) if place.before < len(table) else None
    return Missing(place.text, place.start, place.end, before, after)


def topics_of(counts: Iterable[int], definitions: Definitions) -> tuple[str, ...]:
    """Return the topics of channels, sorted; channels without definition by their id."""
    defined = definitions.channels
    names = {defined[channel].topic if channel in defined else f"channel {channel}" for channel in counts}
    return tuple(sorted(names))
