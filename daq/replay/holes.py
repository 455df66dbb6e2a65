"""Where messages of a log are missing: what a replay may compare or judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daq.channels import HEALTH_TOPIC
from daq.mcap.missing import Missing

_NEIGHBOURS_NS = 1_000_000_000
"""Samples are written at most this long after their bytes, unless the disk stalls."""


@dataclass(frozen=True)
class Holes:
    """Places where a log lacks messages of its devices; damage that costs none, or health reports only, is not one.

    Attributes:
        between: host times (ns since 1970) between which messages are missing although others follow, sorted.
        unplaced: missing parts whose beginning is unknown.
        cut_ns: host time from which everything is missing; None if the end is not missing.
        first_ns: log time from which raw bytes may be missing although others follow; None if at most the end is.
            A hole without a known position may be anywhere, so the result is 0. A hole that is known only by its
            neighbours may contain samples of earlier bytes, because a recorder writes raw bytes first. It therefore
            begins earlier.
    """

    between: tuple[tuple[int, int], ...]
    unplaced: tuple[Missing, ...]
    cut_ns: int | None
    first_ns: int | None

    @classmethod
    def of(cls, missing: Sequence[Missing]) -> Holes:
        """Return the holes among the missing parts of a log."""
        lost = [place for place in missing if place.messages != 0 and place.topics != (HEALTH_TOPIC,)]
        placed = [(place, place.start_ns, place.end_ns) for place in lost if place.start_ns is not None]
        unplaced = tuple(place for place in lost if place.start_ns is None)
        inside = [(place, start, end) for place, start, end in placed if end is not None]
        first = [start - (_NEIGHBOURS_NS if place.messages is None else 0) for place, start, _ in inside]
        return cls(
            tuple(sorted((start, end) for _, start, end in inside)),
            unplaced,
            min((start for _, start, end in placed if end is None), default=None),
            min([*first, *(0 for _ in unplaced)], default=None),
        )
