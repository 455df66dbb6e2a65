"""Decoding a log's raw bytes again, through the same pipelines, and comparing with what was decoded live."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import CHANNELS
from daq.log import Log, open_log
from daq.stream_items import Batch, Event
from daq.streams import make_pipelines
from rig_configs.schema import Rig


@dataclass(frozen=True)
class ChannelCheck:
    """One channel compared: samples decoded live and again, and what differs ("" when nothing does)."""

    topic: str
    live: int
    again: int
    difference: str


def decode_again(log: Log) -> tuple[dict[str, list[Batch]], list[Event]]:
    """Batches by topic and events, from the log's raw bytes alone."""
    rig = Rig.model_validate_json(log.attachments["rig.json"])
    pipelines = make_pipelines(rig.devices, json.loads(log.attachments["identities.json"]))
    batches: dict[str, list[Batch]] = defaultdict(list)
    events: list[Event] = []
    for device, chunk in log.raw_in_order():
        for item in pipelines[device].feed(chunk.direction, chunk.data, chunk.host_ns):
            if isinstance(item, Batch):
                batches[item.channel.topic].append(item)
            else:
                events.append(item)
    return batches, events


def check(path: str | Path) -> list[ChannelCheck]:
    """Decode again and compare every sample channel bit for bit, and the events one by one.

    A log that was cut may hold raw bytes whose samples were not yet written: there the samples it has are compared.

    Raises:
        LogError: not a readable log.
    """
    with open_log(path) as log:
        batches, events = decode_again(log)
        rows = [_compare(log, topic, batches.get(topic, [])) for topic in CHANNELS]
        # threads interleave devices; each device's own order is in its bytes
        live = Counter((e["kind"], e["device"], e["text"]) for e in log.events)
        again = Counter((e.kind, e.device, e.text) for e in events)
        same = live == again if log.complete else live <= again
        rows.append(ChannelCheck("events", live.total(), again.total(), "" if same else "events differ"))
        return rows


def _compare(log: Log, topic: str, batches: list[Batch]) -> ChannelCheck:
    again = sum(len(b.time_ns) for b in batches)
    if topic not in log.topics or not len(log[topic]):
        return ChannelCheck(topic, 0, again, "" if again == 0 else "channel missing in the log")
    live = log[topic]
    count = len(live)
    if count > again or (count < again and log.complete):
        return ChannelCheck(topic, len(live), again, f"{len(live)} samples live, {again} decoded again")
    columns: dict[str, NDArray[Any]] = {
        "time_ns": np.concatenate([b.time_ns for b in batches]),
        "sequence": np.concatenate([b.sequence for b in batches]),
    }
    for name, _ in CHANNELS[topic].fields:
        columns[name] = np.concatenate([b.columns[name] for b in batches])
    differing = [name for name, values in columns.items() if not _same(live, name, values[:count])]
    return ChannelCheck(topic, len(live), again, f"differ in {', '.join(differing)}" if differing else "")


def _same(live: Any, name: str, values: NDArray[Any]) -> bool:
    stored = live.time_ns if name == "time_ns" else live.sequence if name == "sequence" else live[name]
    return np.array_equal(stored, values.astype(stored.dtype), equal_nan=stored.dtype.kind == "f")
