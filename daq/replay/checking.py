"""Check of a log: decode it again and compare with the recorded samples, bit for bit, as far as nothing is missing."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.channels import HEALTH_TOPIC
from daq.drivers.devices import channels_of
from daq.items import Batch
from daq.log import Log, open_log
from daq.log.snapshot import rig_of
from daq.mcap.damage import Missing
from daq.replay.compare import ChannelCheck, ChannelComparison, EventComparison
from daq.replay.stream import decoded, decoder_of, pipelines_of
from daq.version import DECODER
from rig_basics.texts import number_of

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


Progress = Callable[[float], None]


@dataclass(frozen=True)
class ReplayCheck:
    """Result of a check; iterating gives its channels.

    Attributes:
        channels: every sample channel, then the events.
        until_ns: log time up to which the log was compared, because raw bytes are missing from there on; None for all.
        notes: limitations of the result, as sentences.
        recorded_by: `daq.version.DECODER` of the recording; None if the log does not state it.
        decoded_by: that of this version. If it is another one, differences are expected.
    """

    channels: tuple[ChannelCheck, ...]
    until_ns: int | None
    notes: tuple[str, ...]
    recorded_by: int | None
    decoded_by: int

    @property
    def identical(self) -> bool:
        """True if nothing that could be compared differs."""
        return not any(channel.difference for channel in self.channels)

    def __iter__(self) -> Iterator[ChannelCheck]:
        return iter(self.channels)


def check(path: str | Path, progress: Progress | None = None) -> ReplayCheck:
    """Decode a log again and compare every sample and event with the recorded one, bit for bit.

    Damaged, cut and recovered logs are compared as far as possible. From the first missing raw bytes on, decoders and
    clock maps differ from those of the recording, so the comparison ends there and a note states it. At the end of a
    cut log raw bytes may exist whose samples were not written yet; they are counted as extra.

    Args:
        path: the log.
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the file is not a readable log, or cannot be decoded again.
    """
    with open_log(path) as log:
        return check_log(log, progress)


def check_log(log: Log, progress: Progress | None = None) -> ReplayCheck:
    """Check an open log; see `check`."""
    pipelines = pipelines_of(log)
    log.verify()  # before the comparison: damage determines how far it goes
    until_ns = Holes.of(log.missing).first_ns
    cut = any(place.messages != 0 for place in log.missing) or "recovered" in log.metadata
    channels = channels_of(rig_of(log).devices)
    comparisons = {topic: ChannelComparison(log, channel, until_ns, cut) for topic, channel in channels.items()}
    events = EventComparison(log, pipelines, until_ns, cut)
    share = share_of(log, progress)
    for _, chunk, items in decoded(log, pipelines):
        for item in items:
            if isinstance(item, Batch):
                comparisons[item.channel.topic].add(item, chunk.host_ns)
            else:
                events.add(item, chunk.host_ns)
        share(chunk.host_ns)
    rows = (*(comparison.result() for comparison in comparisons.values()), events.result())
    recorded_by = decoder_of(log)
    notes = (*_of_decoders(recorded_by), *_notes(log, set(pipelines), set(channels), until_ns, rows))
    return ReplayCheck(rows, until_ns, notes, recorded_by, DECODER)


def share_of(log: Log, progress: Progress | None) -> Callable[[int], None]:
    """Return a function of the log time that calls `progress` with the completed share, at most a thousand times."""
    span = max(1, log.end_ns - log.start_ns)
    reported = -1

    def report(log_ns: int) -> None:
        nonlocal reported
        thousandth = (log_ns - log.start_ns) * 1000 // span
        if progress is not None and thousandth > reported:
            reported = thousandth
            progress(min(1.0, thousandth / 1000))

    return report


def _of_decoders(recorded_by: int | None) -> Iterator[str]:
    """Yield the note that a log was recorded by other decoders than those of this version."""
    if recorded_by != DECODER:
        first = "an unknown decoder" if recorded_by is None else f"decoder {recorded_by}"
        yield f"recorded by {first}, decoded again by decoder {DECODER}: differences are expected"


def _notes(
    log: Log, decodable: set[str], known: set[str], until_ns: int | None, rows: tuple[ChannelCheck, ...]
) -> Iterator[str]:
    if until_ns is not None:
        until_s = max(0, until_ns - log.start_ns) * 1e-9
        yield f"raw bytes are missing: compared up to {until_s:.3f} s after the log's start, not beyond"
    for place in log.missing:
        yield f"missing: {place}"
    extra = sum(row.extra for row in rows)
    if extra:
        yield (
            f"the log is cut: {number_of(extra, 'sample or event is', 'samples and events are')} in its raw bytes alone"
        )
    unknown = sorted(set(log.devices) - decodable)
    if unknown:
        yield f"not decoded, devices without an installed driver: {', '.join(unknown)}"
    others = sorted(set(log) - known)
    if others:
        yield f"not compared, not made from raw bytes: {', '.join(others)}"
    run = log.metadata.get("run", {})
    if "origin" in run:
        yield f"this log was itself decoded again from {json.dumps(run['origin'])}"
