"""Arrivals from every device of a log in order of host time, decoded again from raw bytes or from stored samples.

A recorder writes the data of several threads, so neighbouring reads of two devices may be in the wrong order. They are
sorted here.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.channels import TX, raw_topic
from daq.drivers.calibrated import CalibratedPipeline
from daq.items import Batch, DeviceEvent
from daq.log import Log
from daq.replay.stream import StoredRows, decoded

_ROWS = 4096  # stored samples per read
_READ_NS = 20_000_000  # stored samples that arrived within this time are treated as one read
_HEADS = ("time_ns", "log_time_ns", "sequence")


@dataclass(frozen=True)
class Arrival:
    """One read, or one write.

    Attributes:
        host_ns: host time, ns since 1970.
        device: name of the device.
        wrote: True for bytes that were sent to the device.
        items: decoded contents of the bytes.
    """

    host_ns: int
    device: str
    wrote: bool
    items: tuple[Batch | DeviceEvent, ...]


class Arrivals:
    """Everything that arrived, iterated in order of host time.

    Args:
        log: the open log.
        pipelines: new pipelines by device.
        device_of: device that fills a channel, by topic.
        disorder_s: largest difference in host time between two reads in the wrong order, s.

    Attributes:
        again: devices whose raw bytes are decoded again.
        stored: topics whose stored samples are used.
    """

    def __init__(
        self,
        log: Log,
        pipelines: Mapping[str, CalibratedPipeline],
        device_of: Mapping[str, str],
        disorder_s: float,
    ) -> None:
        self._log, self._pipelines = log, pipelines
        self._disorder_ns = int(disorder_s * 1e9)
        self.again: tuple[str, ...] = tuple(name for name in self._pipelines if log.count(raw_topic(name)))
        self._device_of = {topic: name for topic, name in device_of.items() if name not in self.again}
        self.stored: tuple[str, ...] = tuple(topic for topic in self._device_of if topic in log and log.count(topic))

    def __iter__(self) -> Iterator[Arrival]:
        sources = [self._decoded(), self._events(), *(self._stored(topic) for topic in self.stored)]
        return heapq.merge(*(self._in_order(source) for source in sources), key=lambda arrival: arrival.host_ns)

    def _in_order(self, arrivals: Iterator[Arrival]) -> Iterator[Arrival]:
        """Yield the arrivals in order, provided they are displaced by at most `disorder_s`."""
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
        """Yield the events of devices whose bytes are not decoded again."""
        devices = set(self._device_of.values())
        found = [note for note in self._log.events if note.get("device") in devices] if devices else []
        for note in sorted(found, key=lambda note: note["time_ns"]):
            facts = {key: value for key, value in note.items() if key not in ("kind", "device", "text", "time_ns")}
            event = DeviceEvent(str(note["kind"]), str(note["device"]), str(note.get("text", "")), facts)
            yield Arrival(note["time_ns"], event.device, False, (event,))

    def _stored(self, topic: str) -> Iterator[Arrival]:
        rows, channel, device = StoredRows(self._log, topic), self._log.channel(topic), self._device_of[topic]
        while len((read := rows.read_next(_ROWS))["time_ns"]):
            host_ns: NDArray[np.int64] = read["log_time_ns"]
            ends = [*(np.flatnonzero(np.diff(host_ns // _READ_NS)) + 1).tolist(), len(host_ns)]
            start = 0
            for end in ends:
                columns = {name: values[start:end] for name, values in read.items() if name not in _HEADS}
                part = slice(start, end)
                batch = Batch(channel, read["time_ns"][part], read["sequence"][part].astype(np.uint32), columns)
                yield Arrival(int(host_ns[end - 1]), device, False, (with_all_fields(batch),))
                start = end


_ADDED = {"code": np.uint32, "flags": np.uint32}


def with_all_fields(batch: Batch) -> Batch:
    """Return the batch with the fields that watches need and that imported logs lack: code, flags, device clock."""
    lacking = {name: np.zeros(len(batch.time_ns), kind) for name, kind in _ADDED.items() if name not in batch.columns}
    own_us = {"node_time_us": (batch.time_ns // 1000).astype(np.uint64)}
    return Batch(batch.channel, batch.time_ns, batch.sequence, {**own_us, **lacking, **batch.columns})
