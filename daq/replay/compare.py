"""Comparison of two decodings of the same bytes, the recorded and the present one, sample by sample in slices."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.items import Batch, DeviceEvent, joined
from daq.log import Log
from daq.replay.stream import StoredRows
from rig_basics.texts import number_of

_SLICE = 65_536  # samples per comparison

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class FirstDifference:
    """The first sample or event that differs.

    Attributes:
        index: index in the channel, from 0.
        time_ns: time in the log, ns since 1970.
        field: name of the value ("time_ns", "log_time_ns", "sequence" or a field; for an event, a key).
        stored, decoded: value in the log and value decoded now; None without such a sample.
    """

    index: int
    time_ns: int
    field: str
    stored: Any
    decoded: Any


@dataclass
class FieldDifference:
    """Differences of one field's values over all compared samples of the channel, in the field's own unit.

    Attributes:
        samples: number of samples that differ.
        largest: largest distance; 0 if only bits without a distance differ (NaN, the sign of 0).
        squares: sum of the squared distances.
        pairs: number of samples that have both values.
    """

    samples: int = 0
    largest: float = 0.0
    squares: float = 0.0
    pairs: int = 0

    @property
    def rms(self) -> float:
        """Root mean square of the distance over all samples that have both values."""
        return math.sqrt(self.squares / self.pairs) if self.pairs else math.nan


@dataclass(frozen=True)
class ChannelCheck:
    """Comparison of one channel.

    Attributes:
        topic: the channel, or "events".
        live: number of samples in the log.
        again: number of samples decoded from its raw bytes.
        compared: number of pairs that were compared.
        differing: number of pairs that differ, plus samples that unexpectedly exist on one side only.
        extra: number of decoded samples that are missing at the end of a cut log.
        first: the first difference.
        fields: differences by field.
        missing: names of fields that only the log or only the present decoder has.
    """

    topic: str
    live: int
    again: int
    compared: int = 0
    differing: int = 0
    extra: int = 0
    first: FirstDifference | None = None
    fields: Mapping[str, FieldDifference] = field(default_factory=dict[str, FieldDifference])
    missing: tuple[str, ...] = ()

    @property
    def difference(self) -> str:
        """Description of the differences; empty without differences."""
        if self.missing:
            return f"the log and this version do not both have {', '.join(self.missing)}"
        if self.fields:
            return f"{self.differing} differ in {', '.join(self.fields)}"
        if self.topic == channels.EVENTS_TOPIC and self.differing:
            return number_of(self.differing, "event differs", "events differ")
        return f"{number_of(self.live, 'sample')} live, {self.again} decoded again" if self.differing else ""


class ChannelComparison:
    """Compares one channel while its samples are decoded.

    Args:
        log: the open log.
        channel: the channel.
        until_ns: log time from which nothing is compared, because the log lacks raw bytes there; None for all.
        cut: True if the log's end is missing, so that raw bytes may exist without their samples.
    """

    def __init__(self, log: Log, channel: channels.Channel, until_ns: int | None, cut: bool) -> None:
        topic = channel.topic
        self._topic, self._until_ns, self._cut = topic, until_ns, cut
        self._channel = channel
        self._rows = StoredRows(log, topic)
        names = set(self._rows.names)
        self._lacking = tuple(sorted(names ^ set(self._channel.names))) if log.count(topic) else ()
        self._both = [name for name in self._channel.names if name in names]
        self._live = log.count(topic)
        self._again = self._compared = self._differing = self._extra = 0
        self._first: FirstDifference | None = None
        self._fields: dict[str, FieldDifference] = {}
        self._arrived: list[tuple[Batch, int]] = []
        self._waiting = 0

    def add(self, batch: Batch, host_ns: int) -> None:
        """Add the next samples that were decoded."""
        self._again += len(batch.time_ns)
        if self._until_ns is not None and host_ns >= self._until_ns:
            return
        self._arrived.append((batch, host_ns))
        self._waiting += len(batch.time_ns)
        if self._waiting >= _SLICE:
            self._compare()

    def result(self) -> ChannelCheck:
        """Return the result; call it once, after everything was added."""
        if self._arrived:
            self._compare()
        left = self._rows.read_next(_SLICE, self._until_ns)
        while len(left["time_ns"]):  # in the log, but not decoded from its raw bytes
            self._lone(self._compared + self._extra, left, in_log=True)
            left = self._rows.read_next(_SLICE, self._until_ns)
        return ChannelCheck(
            self._topic,
            self._live,
            self._again,
            self._compared,
            self._differing,
            self._extra,
            self._first,
            self._fields,
            self._lacking,
        )

    def _compare(self) -> None:
        batch, log_time_ns = joined(self._arrived)
        self._arrived, self._waiting = [], 0
        packed = self._channel.pack(batch.columns)  # as written to a log
        decoded: Columns = {"time_ns": batch.time_ns, "log_time_ns": log_time_ns}
        decoded["sequence"] = (np.asarray(batch.sequence, np.int64) & 0xFFFFFFFF).astype(np.uint32)
        decoded |= {name: np.ascontiguousarray(packed[name]) for name in self._both}
        stored = self._rows.read_next(len(log_time_ns), self._until_ns)
        pairs = len(stored["time_ns"])
        if pairs:
            self._pair(stored, {name: values[:pairs] for name, values in decoded.items()})
        if pairs < len(log_time_ns):
            unpaired = {name: values[pairs:] for name, values in decoded.items()}
            if self._cut and self._until_ns is None:
                self._extra += len(log_time_ns) - pairs
            else:
                self._lone(self._compared, unpaired, in_log=False)

    def _pair(self, stored: Columns, decoded: Columns) -> None:
        differs = np.zeros(len(stored["time_ns"]), bool)
        first: list[tuple[int, str]] = []
        for name, values in decoded.items():
            rows = _differing(stored[name], values)
            found = np.flatnonzero(rows)
            if len(found):
                first.append((int(found[0]), name))
                self._measure(name, stored[name], values, len(found))
                differs |= rows
            elif name in self._fields:
                self._fields[name].pairs += len(values)
        if first and self._first is None:
            row, name = min(first, key=lambda pair: pair[0])
            self._first = FirstDifference(
                self._compared + row,
                int(stored["time_ns"][row]),
                name,
                stored[name][row].item(),
                decoded[name][row].item(),
            )
        self._compared += len(differs)
        self._differing += int(np.count_nonzero(differs))

    def _measure(self, name: str, stored: NDArray[Any], decoded: NDArray[Any], samples: int) -> None:
        difference = self._fields.setdefault(name, FieldDifference(pairs=self._compared))
        if stored.dtype.kind == "f":
            apart = np.abs(decoded.astype(float) - stored.astype(float))
            apart = apart[~np.isnan(apart)]
        else:
            apart = np.abs(decoded.astype(np.int64) - stored.astype(np.int64)).astype(float)
        difference.samples += samples
        difference.largest = max(difference.largest, float(apart.max(initial=0.0)))
        difference.squares += float(np.sum(apart**2))
        difference.pairs += len(apart)

    def _lone(self, index: int, rows: Columns, *, in_log: bool) -> None:
        """Count samples that only the log has, or only the present decoder."""
        self._differing += len(rows["time_ns"])
        if self._first is None:
            shown = int(rows["sequence"][0])
            both = (shown, None) if in_log else (None, shown)
            self._first = FirstDifference(index, int(rows["time_ns"][0]), "sequence", *both)


def _differing(stored: NDArray[Any], decoded: NDArray[Any]) -> NDArray[np.bool_]:
    """Return the rows whose bits differ: NaN equals the same NaN, and −0 differs from 0."""
    kind = f"u{stored.dtype.itemsize}"
    same_kind = np.ascontiguousarray(decoded.astype(stored.dtype, copy=False))
    return np.ascontiguousarray(stored).view(kind) != same_kind.view(kind)


class EventComparison:
    """Compares events by device: threads interleave devices, but the order within a device follows its bytes.

    Args:
        log: the open log.
        devices: devices with a pipeline; events of others (the host's own) are not made from raw bytes.
        until_ns, cut: as in `ChannelComparison`.
    """

    def __init__(self, log: Log, devices: Iterable[str], until_ns: int | None, cut: bool) -> None:
        self._until_ns, self._cut = until_ns, cut
        self._live: dict[str, list[dict[str, Any]]] = {device: [] for device in devices}
        for event in log.events:
            if event.get("device") in self._live:
                self._live[event["device"]].append(event)
        self._again: dict[str, list[dict[str, Any]]] = defaultdict(list)
        self._late = 0

    def add(self, event: DeviceEvent, host_ns: int) -> None:
        """Add the next event that was decoded."""
        if self._until_ns is not None and host_ns >= self._until_ns:
            self._late += 1
            return
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        as_stored = json.loads(channels.pack_note(note))
        self._again[event.device].append(as_stored | {"time_ns": int(event.facts.get("time_ns", host_ns))})

    def result(self) -> ChannelCheck:
        """Return the result."""
        live = sum(map(len, self._live.values()))
        again = sum(map(len, self._again.values()))
        compared = differing = extra = 0
        firsts: list[FirstDifference] = []
        for device, stored in self._live.items():
            made = self._again[device]
            kept = stored if self._until_ns is None else stored[: len(made)]
            compared += min(len(kept), len(made))
            if self._cut and self._until_ns is None:
                extra += max(0, len(made) - len(kept))
                made = made[: len(kept)]
            wrong = [(i, *pair) for i, pair in enumerate(zip_longest(kept, made)) if pair[0] != pair[1]]
            differing += len(wrong)
            firsts += [_event_difference(*each) for each in wrong[:1]]
        first = min(firsts, key=lambda d: d.time_ns, default=None)
        return ChannelCheck(channels.EVENTS_TOPIC, live, again + self._late, compared, differing, extra, first)


def _event_difference(
    index: int, stored: Mapping[str, Any] | None, decoded: Mapping[str, Any] | None
) -> FirstDifference:
    """Return the difference of two events, of which one may be missing."""
    if stored is None or decoded is None:
        texts = (
            None if event is None else f"{event['kind']} {event['device']}: {event['text']}"
            for event in (stored, decoded)
        )
        return FirstDifference(index, (stored or decoded or {})["time_ns"], "kind", *texts)
    key = next(key for key in {**stored, **decoded} if stored.get(key) != decoded.get(key))
    return FirstDifference(index, stored["time_ns"], key, stored.get(key), decoded.get(key))
