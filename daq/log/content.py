"""Contents of one log: amount and rate of each channel, and the events; memory use is bounded for long logs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from daq.channels import HEALTH_TOPIC, RX, raw_topic
from daq.items import LOSS_KINDS
from daq.log import Log
from daq.log.outcome import TRIP

_ALL_BEFORE, _ALL_AFTER = -(2**63), 2**63 - 1
_STRETCH_MESSAGES = 400_000
_EDGE_NS = 10**9  # length of the first window in which the end of a channel is searched …
_WIDER = 8  # … and growth factor of the following ones
_READS_COUNTED = 100_000
_MOST_LINES = 200
_MOST_TRIPS = 16  # a session ends at the first trip
_NUMBERS = re.compile(r"\d+(?:\.\d+)?")


@dataclass(frozen=True)
class ChannelContent:
    """One sample channel.

    Attributes:
        samples: number of samples.
        span_s: time from the first sample to the last, s.
        rate_Hz: mean rate over that span, gaps included.
    """

    samples: int
    span_s: float
    rate_Hz: float


@dataclass(frozen=True)
class RawContent:
    """Raw bytes of one device.

    Attributes:
        messages: number of reads and writes.
        bytes_in, bytes_out: bytes from and to the device; None if the log is long and was not read completely.
    """

    messages: int
    bytes_in: int | None
    bytes_out: int | None


@dataclass
class EventLine:
    """Events that differ only in numbers: times of the first and last, s since the log's start, and their number."""

    first_s: float
    last_s: float
    device: str
    kind: str
    text: str
    count: int = 1


@dataclass
class EventContent:
    """Events of a log.

    Attributes:
        kinds: number of events of each kind.
        lines: similar events combined, in the order of their first.
        more: number of events beyond the maximum number of lines.
        lost: number of events and their total duration in s, by device and kind (`LOSS_KINDS` and "silence").
        trips: complete events of interlock trips; only the first ones if there are many.
    """

    kinds: Counter[str] = field(default_factory=Counter[str])
    lines: list[EventLine] = field(default_factory=list[EventLine])
    more: int = 0
    lost: dict[str, dict[str, tuple[int, float]]] = field(default_factory=dict[str, dict[str, tuple[int, float]]])
    trips: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])


def stretches(log: Log) -> Iterator[tuple[float, Log]]:
    """Yield the log in parts of bounded size, in order of time, each with the share completed after it, 0 … 1."""
    messages = sum(log.count(topic) for topic in log.topics)
    count = max(1, -(-messages // _STRETCH_MESSAGES))
    length = max(1, (log.end_ns - log.start_ns) // count)
    edges = [_ALL_BEFORE, *(log.start_ns + number * length for number in range(1, count)), _ALL_AFTER]
    for number in range(count):
        yield (number + 1) / count, log.between(edges[number], edges[number + 1])


def channel_content(log: Log, topic: str) -> ChannelContent:
    """Return amount and rate of a sample channel, from the log's counts and the channel's first and last samples.

    Raises:
        LogError: the messages do not match their schema.
    """
    samples = log.count(topic)
    first, last = _end_of(log, topic, newest=False), _end_of(log, topic, newest=True)
    span = (last - first) * 1e-9 if first is not None and last is not None else 0.0
    return ChannelContent(samples, span, (samples - 1) / span if span > 0 else 0.0)


def raw_content(log: Log, thorough: bool = True) -> dict[str, RawContent]:
    """Return the amount of raw bytes of each device.

    Args:
        thorough: read long logs too; otherwise the bytes of long logs are not counted.
    """
    messages = {device: log.count(raw_topic(device)) for device in log.devices}
    if not thorough and sum(messages.values()) > _READS_COUNTED:
        return {device: RawContent(count, None, None) for device, count in messages.items()}
    ways = {device: [0, 0] for device in log.devices}
    for device, chunk in log.raw_in_order():
        ways[device][chunk.direction != RX] += len(chunk.data)
    return {device: RawContent(count, *ways[device]) for device, count in messages.items()}


def last_health(log: Log) -> dict[str, Any] | None:
    """Return the last health report; None for a log without health reports."""
    for part in _from_the_edge(log, newest=True) if log.count(HEALTH_TOPIC) else ():
        if reports := part.health:
            return reports[-1]
    return None


def events_of(log: Log) -> Iterator[dict[str, Any]]:
    """Yield every event with its ``time_ns``, part by part."""
    for _, part in stretches(log):
        yield from part.events


def event_content(events: Iterable[dict[str, Any]], start_ns: int) -> EventContent:
    """Combine similar events; times count from `start_ns`."""
    content = EventContent()
    known: dict[tuple[str, str, str], EventLine] = {}
    for event in events:
        kind, device, text = (str(event.get(name, "")) for name in ("kind", "device", "text"))
        time_s = (event["time_ns"] - start_ns) * 1e-9
        content.kinds[kind] += 1
        alike = (kind, device, _NUMBERS.sub("#", text))
        if alike in known:
            known[alike].last_s = time_s
            known[alike].count += 1
        elif len(known) < _MOST_LINES:
            known[alike] = EventLine(time_s, time_s, device, kind, text)
            content.lines.append(known[alike])
        else:
            content.more += 1
        if kind == TRIP and len(content.trips) < _MOST_TRIPS:
            content.trips.append(event)
        if kind == "silence":
            device = str(event.get("of", device))
        if kind in LOSS_KINDS or (kind == "silence" and "span_s" in event):  # a silence is counted at its end
            count, span_s = content.lost.setdefault(device, {}).get(kind, (0, 0.0))
            content.lost[device][kind] = (count + 1, span_s + seconds(event, "span_s"))
    return content


def seconds(facts: Mapping[str, Any], name: str) -> float:
    """Return a time stored in an event or a health report, s; 0 if it is missing or not a finite number."""
    value = facts.get(name, 0.0)
    try:
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
    except OverflowError:  # usual: not a time, in a foreign file
        return 0.0


def _end_of(log: Log, topic: str, newest: bool) -> int | None:
    """Return the time of a channel's first or last sample, ns since 1970; None if it has no samples."""
    for part in _from_the_edge(log, newest) if log.count(topic) else ():
        if topic in part and len(part[topic]):
            times = part[topic].time_ns
            return int(times.max() if newest else times.min())
    return None


def _from_the_edge(log: Log, newest: bool) -> Iterator[Log]:
    """Yield the log's last second (or first), then larger and larger parts, finally the whole log."""
    window = _EDGE_NS
    while window < log.end_ns - log.start_ns:
        if newest:
            yield log.between(log.end_ns - window, _ALL_AFTER)
        else:
            yield log.between(_ALL_BEFORE, log.start_ns + window)
        window *= _WIDER
    yield log
