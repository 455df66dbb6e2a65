# pyright: strict
"""What arrived from every device of a log, in the order of host time: decoded again where its raw bytes are there,
otherwise as its samples stand in the log.

A recorder writes what its threads leave behind, so that neighbouring reads of two devices may stand the wrong way
round; they are put in order here.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.channels import HEALTH_TOPIC, TX, raw_topic
from daq.drivers.contract import Pipeline
from daq.drivers.items import Batch, Event
from daq.log import Log
from daq.log.samples import Missing
from daq.replay.stored import StoredRows
from daq.replay.stream import decoded

_ROWS = 4096  # stored samples taken at once
_READ_NS = 20_000_000  # stored samples that arrived within this stand for one read
_HEADS = ("time_ns", "log_time_ns", "sequence")


@dataclass(frozen=True)
class Hole:
    """A stretch of host time in which messages of a log are missing.

    Attributes:
        start_ns, end_ns: first and last host time, ns since 1970.
    """

    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Arrival:
    """One read, or one write.

    Attributes:
        host_ns: when.
        device: which.
        wrote: bytes went to the device; nothing of it came.
        items: what the bytes hold.
    """

    host_ns: int
    device: str
    wrote: bool
    items: tuple[Batch | Event, ...]


def holes_of(missing: list[Missing]) -> tuple[Hole, ...]:
    """Holes that lie between two known times, sorted; the cut end of a log is none."""
    found = [
        Hole(place.start_ns, place.end_ns)
        for place in missing
        if place.messages != 0 and place.topics != (HEALTH_TOPIC,)
        if place.start_ns is not None and place.end_ns is not None
    ]
    return tuple(sorted(found, key=lambda hole: hole.start_ns))


class Arrivals:
    """Everything that arrived.

    Args:
        log: open.
        pipelines: fresh ones, by device.
        device_of: which device fills a channel, by topic.
        disorder_s: how far apart in host time two reads may stand the wrong way round.

    Attributes:
        again: devices whose raw bytes are decoded again.
        stored: topics whose stored samples are taken.
    """

    def __init__(
        self,
        log: Log,
        pipelines: Mapping[str, Pipeline],
        device_of: Mapping[str, str],
        disorder_s: float,
    ) -> None:
        self._log, self._pipelines = log, pipelines
        self._disorder_ns = int(disorder_s * 1e9)
        self.again = tuple(name for name in self._pipelines if log.count(raw_topic(name)))
        self._device_of = {topic: name for topic, name in device_of.items() if name not in self.again}
        self.stored = tuple(topic for topic in self._device_of if topic in log and log.count(topic))

    def __iter__(self) -> Iterator[Arrival]:
        sources = [self._decoded(), self._events(), *(self._stored(topic) for topic in self.stored)]
        return heapq.merge(*(self._in_order(source) for source in sources), key=lambda arrival: arrival.host_ns)

    def _in_order(self, arrivals: Iterator[Arrival]) -> Iterator[Arrival]:
        """Sorted, as far as they stand no farther apart than `disorder_s`."""
        waiting: list[tuple[int, int, Arrival]] = []
        newest = last = 0
        for number, arrival in enumerate(arrivals):
            newest = max(newest, arrival.host_ns)
            heapq.heappush(waiting, (max(arrival.host_ns, last), number, arrival))
            while waiting[0][0] < newest - self._disorder_ns:
                last, _, first = heapq.heappop(waiting)
                yield first
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _decoded(self) -> Iterator[Arrival]:
        for device, chunk, items in decoded(self._log, self._pipelines):
            yield Arrival(chunk.host_ns, device, chunk.direction == TX, tuple(items))

    def _events(self) -> Iterator[Arrival]:
        """Events of devices whose bytes are not decoded again."""
        known = set(self._device_of.values())
        found = [note for note in self._log.events if note.get("device") in known] if known else []
        for note in sorted(found, key=lambda note: note["time_ns"]):
            facts = {key: value for key, value in note.items() if key not in ("kind", "device", "text", "time_ns")}
            event = Event(str(note["kind"]), str(note["device"]), str(note.get("text", "")), facts)
            yield Arrival(note["time_ns"], event.device, False, (event,))

    def _stored(self, topic: str) -> Iterator[Arrival]:
        rows, channel, device = StoredRows(self._log, topic), self._log.channel(topic), self._device_of[topic]
        while len((taken := rows.take(_ROWS))["time_ns"]):
            host_ns: NDArray[np.int64] = taken["log_time_ns"]
            ends = [*(np.flatnonzero(np.diff(host_ns // _READ_NS)) + 1).tolist(), len(host_ns)]
            start = 0
            for end in ends:
                columns = {name: values[start:end] for name, values in taken.items() if name not in _HEADS}
                part = slice(start, end)
                batch = Batch(channel, taken["time_ns"][part], taken["sequence"][part].astype(np.uint32), columns)
                yield Arrival(int(host_ns[end - 1]), device, False, (with_all_fields(batch),))
                start = end


_LATER = {"code": np.uint32, "flags": np.uint32}


def with_all_fields(batch: Batch) -> Batch:
    """A batch with the fields that watches ask for and that logs of other origin lack: no code, no flag, no clock of
    the device's own."""
    lacking = {name: np.zeros(len(batch.time_ns), kind) for name, kind in _LATER.items() if name not in batch.columns}
    own_us = {"node_time_us": (batch.time_ns // 1000).astype(np.uint64)}
    return Batch(batch.channel, batch.time_ns, batch.sequence, {**own_us, **lacking, **batch.columns})
