"""A log decoded again and compared with what was decoded live, bit for bit."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from daq.channels import HEALTH_TOPIC
from daq.drivers.devices import channels_of
from daq.drivers.items import Batch
from daq.log import Log, open_log
from daq.log.samples import Missing
from daq.log.snapshot import rig_of
from daq.replay.compare import ChannelCheck, ChannelComparison, EventComparison
from daq.replay.stream import decoded, pipelines_of

Progress = Callable[[float], None]
_NEIGHBOURS_NS = 1_000_000_000  # samples are written this long after their bytes at the most, but for a stalled disk


@dataclass(frozen=True)
class Check:
    """A log decoded again and compared; iterating gives its channels.

    Attributes:
        channels: every sample channel, then the events.
        until_ns: log time up to which it was compared, because raw bytes are missing from there on; None for all.
        notes: what a reader of the result must know, sentences.
    """

    channels: tuple[ChannelCheck, ...]
    until_ns: int | None
    notes: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """Nothing that could be compared differs."""
        return not any(channel.difference for channel in self.channels)

    def __iter__(self) -> Iterator[ChannelCheck]:
        return iter(self.channels)


def check(path: str | Path, progress: Progress | None = None) -> Check:
    """Decode again and compare every sample and event with the log's own, bit for bit.

    What a damaged, cut or recovered log cannot answer is not asked: from the first place on where raw bytes are
    missing, decoders and clock maps go other ways than they went live, so the comparison ends there and says so. At
    the end of a cut log raw bytes may stand whose samples were not written yet; they are counted as extra.

    Args:
        progress: told the share done, 0 … 1.

    Raises:
        LogError: not a readable log, or one that cannot be decoded again.
    """
    with open_log(path) as log:
        return check_log(log, progress)


def check_log(log: Log, progress: Progress | None = None) -> Check:
    """See `check`."""
    pipelines = pipelines_of(log)
    log.verify()  # all of it before anything is compared: what is damaged decides how far
    until_ns = first_hole_ns(log.missing)
    cut = any(place.messages != 0 for place in log.missing) or "recovered" in log.metadata
    rig = rig_of(log)
    known = channels_of(rig.devices)
    comparisons = {topic: ChannelComparison(log, channel, until_ns, cut) for topic, channel in known.items()}
    events = EventComparison(log, pipelines, until_ns, cut)
    share = share_of(log, progress)
    device_of = rig.roles.device_of
    unflagged = {device_of[topic] for topic, comparison in comparisons.items() if comparison.unasked}
    for _, chunk, items in decoded(log, pipelines):
        for item in items:
            if isinstance(item, Batch):
                comparisons[item.channel.topic].add(item, chunk.host_ns)
            elif item.kind != "suspect" or item.device not in unflagged:
                events.add(item, chunk.host_ns)
        share(chunk.host_ns)
    rows = (*(comparison.result() for comparison in comparisons.values()), events.result())
    notes = [*_notes(log, set(pipelines), set(known), until_ns, rows)]
    notes += [
        f"not compared, the log is of a version that did not write it: {', '.join(comparison.unasked)} of {topic}"
        for topic, comparison in comparisons.items()
        if comparison.unasked
    ]
    return Check(rows, until_ns, tuple(notes))


def first_hole_ns(missing: list[Missing]) -> int | None:
    """Log time from which on messages are missing although others follow; None when nothing but the end is.

    A hole that cannot be placed may be anywhere: 0. One known only by its neighbours may hold samples of bytes that
    stand before it, for a recorder writes raw bytes first: it begins earlier than it seems.
    """
    holes = [
        (place.start_ns or 0) - (_NEIGHBOURS_NS if place.messages is None else 0)
        for place in missing
        if place.messages != 0 and place.topics != (HEALTH_TOPIC,) and not _is_the_end(place)
    ]
    return min(holes, default=None)


def _is_the_end(place: Missing) -> bool:
    return place.end_ns is None and place.start_ns is not None


def share_of(log: Log, progress: Progress | None) -> Callable[[int], None]:
    """What to call with each log time so that `progress` is told the share done, a thousand times at most."""
    span = max(1, log.end_ns - log.start_ns)
    told = -1

    def tell(log_ns: int) -> None:
        nonlocal told
        thousandth = (log_ns - log.start_ns) * 1000 // span
        if progress is not None and thousandth > told:
            told = thousandth
            progress(min(1.0, thousandth / 1000))

    return tell


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
        yield f"the log is cut: {extra} samples and events are in its raw bytes alone"
    unknown = sorted(set(log.devices) - decodable)
    if unknown:
        yield f"not decoded, this version knows no such device: {', '.join(unknown)}"
    others = sorted(set(log) - known)
    if others:
        yield f"not compared, not made from raw bytes: {', '.join(others)}"
    run = log.metadata.get("run", {})
    if "origin" in run:
        yield f"this log was itself decoded again from {json.dumps(run['origin'])}"
