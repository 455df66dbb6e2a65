"""Damaged places of a file, and what is known of what they held."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.log.samples import Missing
from daq.mcap.chunks import ChunkTable
from daq.mcap.records import Definitions


@dataclass(frozen=True)
class Held:
    """Messages that an index tells of: how many by channel id, first and last log time, ns."""

    counts: dict[int, int]
    span_ns: tuple[int, int] | None


@dataclass
class Place:
    """A stretch of a file that is not what it should be.

    Attributes:
        start, end: bytes.
        text: why.
        before: how many good chunks stand before it.
        held: what is known to have stood there; None when nothing is, empty when no message did.
    """

    start: int
    end: int
    text: str
    before: int
    held: list[Held] | None = None


@dataclass
class Damage:
    """All places of a file, in file order."""

    places: list[Place] = field(default_factory=list)

    def note(self, start: int, end: int, text: str, before: int) -> Place:
        """Add a place."""
        self.places.append(Place(start, end, text, before))
        return self.places[-1]

    def explain(self, index: ChunkTable, found: ChunkTable) -> None:
        """Tell from a sound index which chunks are not among those found, and so what each place held.

        A chunk that is not at its place may stand at another one: each found where the index does not tell of it
        accounts for one.
        """
        known = sorted(self.places, key=lambda place: place.start)
        sorted_starts = [place.start for place in known]
        for place in self.places:
            place.held = []
        for chunk in _not_found(index, found):
            start, end = int(index.start[chunk]), int(index.start[chunk] + index.length[chunk])
            near = bisect_left(sorted_starts, end) - 1
            if near >= 0 and known[near].end > start:
                at = known[near]
            else:
                at = self.note(start, end, "a chunk of the index is not there", int((found.start < start).sum()))
            at.held = at.held or []
            at.held.append(Held(dict(index.entries(chunk)), (int(index.start_ns[chunk]), int(index.end_ns[chunk]))))
        self.places.sort(key=lambda place: place.start)

    def settle(self, found: ChunkTable, unnamed: set[int]) -> None:
        """Forget what message indexes tell of chunks that stand elsewhere in the file, so are not missing.

        Args:
            found: the good chunks.
            unnamed: where those begin that lack message indexes of their own. Where only others fit what is told, it
                may be of them, or of one lost that was like them: then nothing is known.
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
        """The places in words and numbers; where nothing else is known, the neighbours tell the times."""
        return [_missing(place, definitions, table) for place in self.places]


def _not_found(index: ChunkTable, found: ChunkTable) -> list[int]:
    """Numbers of the index's chunks that are not among those found, each of which stands for one."""
    as_told, in_place = _pairs(index, found)
    spare: dict[tuple[object, ...], list[int]] = {}
    for number in np.flatnonzero(~in_place).tolist():
        spare.setdefault(_facts(found, number), []).append(number)
    lacking: list[int] = []
    for number in np.flatnonzero(~as_told).tolist():
        if elsewhere := spare.get(_facts(index, number)):
            elsewhere.pop()
        else:
            lacking.append(number)
    # where the right messages stand at the right place, the index is wrong about their times
    holding = {int(found.start[n]): _entries(found, n) for numbers in spare.values() for n in numbers}
    return [number for number in lacking if holding.get(int(index.start[number])) != _entries(index, number)]


def _pairs(index: ChunkTable, found: ChunkTable) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of the index's chunks are found at their place just as it tells, and which found ones these are."""
    _, a, b = np.intersect1d(index.start, found.start, assume_unique=True, return_indices=True)
    told, there = (table.messages(table.numbers(None), range(65536)) for table in (index, found))
    same = (told[a] == there[b]) & (index.unpacked[a] == found.unpacked[b])
    same &= (told[a] == 0) | ((index.start_ns[a] == found.start_ns[b]) & (index.end_ns[a] == found.end_ns[b]))
    as_told, in_place = np.zeros(len(index), bool), np.zeros(len(found), bool)
    as_told[a[same]] = in_place[b[same]] = True
    return as_told, in_place


def _facts(table: ChunkTable, chunk: int) -> tuple[object, ...]:
    """What both an index and a chunk itself tell."""
    return int(table.start_ns[chunk]), int(table.end_ns[chunk]), int(table.unpacked[chunk]), _entries(table, chunk)


def _entries(table: ChunkTable, chunk: int) -> frozenset[tuple[int, int]]:
    return frozenset(table.entries(chunk))


def _alike(held: Held, found: ChunkTable) -> list[int]:
    """Chunks that hold as many messages of that time."""
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
    """Names of channels, sorted; those without a name by their id."""
    known = definitions.channels
    names = {known[channel].topic if channel in known else f"channel {channel}" for channel in counts}
    return tuple(sorted(names))
