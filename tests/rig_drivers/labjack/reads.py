"""A LabJack's pipeline with the answers that it reads."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.labjack import wire
from rig_drivers.labjack.driver import DRIVER
from rig_drivers.labjack.settings import LabJack
from rig_drivers.labjack.stream import LabJackPipeline
from rig_testing.bench import Items

S, MS, PERIOD_NS = 1_000_000_000, 1_000_000, 250_000
START = 1_700_000_000 * S
LASERS = {"east": {"axis": "x", "input": "AIN0"}, "north": {"axis": "y", "input": "AIN1"}}
OTHER = {"quantity": "acceleration_m_per_s2", "per_V": 10.0}
THREE = {"others": {"a": {"input": "AIN3", **OTHER}}}  # three inputs with the two lasers
GOOD, EMPTY = [40000, 41000], [0xFFFF, 0xFFFF]


def settings(**more: Any) -> LabJack:
    return LabJack.model_validate({"driver": "labjack", "port": "socket://x:502", "lasers": LASERS, **more})


def events(items: Items, *kinds: str) -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and (not kinds or item.kind in kinds)]


def batches(items: Items, topic: str = "laser/x") -> list[Batch]:
    return [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]


def numbers(items: Items, topic: str = "laser/x") -> list[int]:
    return [int(n) for batch in batches(items, topic) for n in batch.sequence]


def last_ns(items: Items) -> int:
    return int(batches(items)[-1].time_ns[-1])


class Reads:
    """A pipeline, the time, and the number of the next answer; `items` are those of all reads."""

    def __init__(self, identity: Mapping[str, Any] | None = None, **more: Any) -> None:
        made = DRIVER.pipeline("lab", settings(**more), identity or {})
        assert isinstance(made, LabJackPipeline)
        self.pipeline, self.items, self.now_ns, self.number = made, list[Batch | DeviceEvent](), START, 0x8000

    def feed(self, data: bytes, after_ns: int = 0, direction: int = RX) -> Items:
        self.now_ns += after_ns
        found = self.pipeline.feed(direction, data, self.now_ns)
        self.items += found
        return found

    def answer(
        self, samples: list[int], after_ns: int = 0, backlog: int = 0, status: int = 0, info: int = 0, padding: int = 0
    ) -> Items:
        """Feed the device's answer to a stream read, from the facts of its layout."""
        body = struct.pack(f">4H{len(samples)}H", len(samples), backlog, status, info, *samples) + bytes(padding)
        data = struct.pack(">HHHBB", self.number, 0, 2 + len(body), 1, 0x4C) + body
        self.number = 0x8000 | self.number + 1 & 0x7FFF
        return self.feed(data, after_ns)

    def answers(self, count: int, scans: int = 40, after_ns: int = 10 * MS, scan: list[int] = GOOD) -> Items:
        """Feed answers of as many scans as the device measures between them."""
        return [item for _ in range(count) for item in self.answer(scan * scans, after_ns)]

    def refuse(self, body: bytes = b"\x04") -> Items:
        self.number += 1
        return self.feed(wire.encode(wire.Message(self.number - 1, wire.REFUSED, body)))

    def detail(self, body: bytes, function: int = wire.FEEDBACK) -> Items:
        """Feed the answer to the read of a refusal's error."""
        return self.feed(wire.encode(wire.Message(wire.ERROR_NUMBER, function, body)))

    def command(self, number: int = 9, on: int = 1) -> None:
        """Feed the host's command that starts or ends the stream."""
        parts = [wire.write(wire.Register.STREAM_ENABLE, struct.pack(">I", on)), wire.read(4002, 2)]
        assert self.feed(wire.request(number, parts), direction=TX) == []

    def reply(self, number: int = 9, function: int = wire.FEEDBACK) -> Items:
        """Feed the device's answer to a command."""
        return self.feed(wire.encode(wire.Message(number, function, struct.pack(">f", 4000.0))))

    @property
    def lost(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}
