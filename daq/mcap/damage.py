"""Damaged places of a file, and what is known of what they held."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

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
        """Tell from a sound index which chunks are not among those found, and so what each place held."""
        starts = set(found.start.tolist())
        known = sorted(self.places, key=lambda place: place.start)
        sorted_starts = [place.start for place in known]
        for place in self.places:
            place.held = []
        for chunk, start in enumerate(index.start.tolist()):
            if start in starts:
                continue
            end = start + int(index.length[chunk])
            near = bisect_left(sorted_starts, end) - 1
            if near >= 0 and known[near].end > start:
                at = known[near]
            else:
                at = self.note(start, end, "a chunk of the index is not there", int((found.start < start).sum()))
            at.held = at.held or []
            at.held.append(Held(dict(index.entries(chunk)), (int(index.start_ns[chunk]), int(index.end_ns[chunk]))))
        self.places.sort(key=lambda place: place.start)

    def settle(self, found: ChunkTable) -> None:
        """Forget what message indexes tell of chunks that stand elsewhere in the file, so are not missing."""
        for place in self.places:
            if place.held:
                place.held = [held for held in place.held if not _stands_elsewhere(held, found)]

    def missing(self, definitions: Definitions, table: ChunkTable) -> list[Missing]:
        """The places in words and numbers; where nothing else is known, the neighbours tell the times."""
        return [_missing(place, definitions, table) for place in self.places]


def _stands_elsewhere(held: Held, found: ChunkTable) -> bool:
    if held.span_ns is None:
        return not held.counts
    around = (found.start_ns <= held.span_ns[0]) & (found.end_ns >= held.span_ns[1])
    return any(held.counts.items() <= dict(found.entries(chunk)).items() for chunk in np.flatnonzero(around).tolist())


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
