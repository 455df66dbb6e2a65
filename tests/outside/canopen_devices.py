"""CANopen devices on the node of the `canopen` library, which serves objects, network commands and heartbeats."""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Mapping

import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

Objects = Mapping[tuple[int, int], tuple[int, int]]
"""Type of the library and initial value of each object, by index and sub-index."""

TICK_S = 0.002
STATES = {0x40: "disabled", 0x21: "ready", 0x23: "on", 0x27: "enabled", 0x07: "quick stop"}


def dictionary(objects: Objects) -> ObjectDictionary:
    """Describe objects to the library; an index with several sub-indices is a record."""
    found = ObjectDictionary()
    records = {index for index, sub in objects if sub}
    for index in sorted(records):
        found.add_object(ODRecord(f"{index:04X}", index))
    for (index, sub), (kind, value) in objects.items():
        variable = ODVariable(f"{index:04X}.{sub}", index, sub)
        variable.data_type, variable.default = kind, value
        if index in records:
            found[index].add_member(variable)
        else:
            found.add_object(variable)
    return found


def pdo_objects(at: int, cob: int, kind: int, mapped: tuple[int, ...]) -> dict[tuple[int, int], tuple[int, int]]:
    """Return communication and mapping of a PDO whose parameters are at an index."""
    found = {(at, 0): (UNSIGNED8, 5), (at, 1): (UNSIGNED32, cob), (at, 2): (UNSIGNED8, kind), (at, 3): (UNSIGNED16, 0)}
    found |= {(at, 5): (UNSIGNED16, 0), (at + 0x200, 0): (UNSIGNED8, len(mapped))}
    return found | {
        (at + 0x200, sub): (UNSIGNED32, mapped[sub - 1] if sub <= len(mapped) else 0) for sub in range(1, 5)
    }


class Device:
    """A node with a thread that calls `tick`.

    Args:
        channel: channel of python-can's virtual bus.
        number: node number.
        objects: its objects without device type, errors and heartbeats.
        device_type: its object 1000h.
    """

    def __init__(self, channel: str, number: int, objects: Objects, device_type: int) -> None:
        self.number = number
        self.network = canopen.Network()
        self.network.connect(interface="virtual", channel=channel)
        usual = {(0x1000, 0): (UNSIGNED32, device_type), (0x1001, 0): (UNSIGNED8, 0), (0x1005, 0): (UNSIGNED32, 0x80)}
        usual |= {(0x1003, 0): (UNSIGNED8, 0), (0x1003, 1): (UNSIGNED32, 0), (0x1017, 0): (UNSIGNED16, 0)}
        self.node = canopen.LocalNode(number, dictionary(usual | dict(objects)))
        self.network.add_node(self.node)
        self.node.nmt.state = "PRE-OPERATIONAL"
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def of(self, index: int, sub: int = 0) -> int:
        """Return the unsigned value of an object."""
        return int.from_bytes(self.node.get_data(index, sub), "little")

    @property
    def operational(self) -> bool:
        """Whether its process data is on."""
        return self.node.nmt.state == "OPERATIONAL"

    def report(self, data: bytes) -> None:
        """Send TPDO1 if it is on."""
        cob = self.of(0x1800, 1)
        if self.operational and not cob >> 31:
            self.network.send_message(cob & 0x7FF, data)

    def tick(self, passed_s: float) -> None:
        """Go on by some time, s."""

    def close(self) -> None:
        """End thread and bus."""
        self._ended.set()
        self._thread.join()
        self.network.disconnect()

    def _run(self) -> None:
        last = time.monotonic()
        while not self._ended.wait(TICK_S):
            now = time.monotonic()
            self.tick(now - last)
            last = now


class OutsideEncoder(Device):
    """A multi-turn encoder that reports at each SYNC and turns evenly from a position.

    Attributes:
        reported: its positions so far.
    """

    def __init__(self, channel: str, number: int, per_turn: int, start: int, per_report: int) -> None:
        self.reported: list[int] = []
        self._next, self._per_report, self._positions = start, per_report, 4096 * per_turn
        objects = {
            (0x1018, 0): (UNSIGNED8, 4),
            (0x1018, 1): (UNSIGNED32, 0x1234),
            (0x1018, 2): (UNSIGNED32, 77),
            (0x1018, 3): (UNSIGNED32, 2),
            (0x1018, 4): (UNSIGNED32, 1_000 + number),
            (0x6000, 0): (UNSIGNED16, 0),
            (0x6004, 0): (UNSIGNED32, start),
            (0x6200, 0): (UNSIGNED16, 0),
            (0x6501, 0): (UNSIGNED32, per_turn),
            (0x6502, 0): (UNSIGNED16, 4096),
            **pdo_objects(0x1800, 0x180 + number, 254, (0x6004_0020,)),
            **pdo_objects(0x1801, 0x280 + number, 1, (0x6004_0020,)),
        }
        super().__init__(channel, number, objects, 0x0002_0196)
        self.network.subscribe(0x80, self._sampled)

    def _sampled(self, cob: int, data: bytearray, timestamp: float) -> None:
        if self.operational and self.of(0x1800, 2) == 1:
            self.reported.append(self._next)
            self.report(struct.pack("<I", self._next))
            self._next = (self._next + self._per_report) % self._positions


class OutsideDrive(Device):
    """A drive in velocity mode with ramps, reports every 10 ms and a watch of the host's heartbeat.

    Attributes:
        rpm: its speed.
        state: its state, a value of STATES.
        quick_stops: stops by the watch.
    """

    def __init__(self, channel: str, number: int) -> None:
        self.rpm, self.state, self.quick_stops = 0.0, "disabled", 0
        self._mode, self._target, self._due_s, self._silent_s = 0, 0, 0.0, -math.inf
        objects = {
            (0x1016, 0): (UNSIGNED8, 1),
            (0x1016, 1): (UNSIGNED32, 0),
            (0x6040, 0): (UNSIGNED16, 0),
            (0x6041, 0): (UNSIGNED16, 0x40),
            (0x6042, 0): (INTEGER16, 0),
            (0x6044, 0): (INTEGER16, 0),
            (0x6048, 0): (UNSIGNED8, 2),
            (0x6048, 1): (UNSIGNED32, 50),
            (0x6048, 2): (UNSIGNED16, 1),
            (0x6049, 0): (UNSIGNED8, 2),
            (0x6049, 1): (UNSIGNED32, 50),
            (0x6049, 2): (UNSIGNED16, 1),
            (0x6060, 0): (INTEGER8, 0),
            (0x6061, 0): (INTEGER8, 0),
            **pdo_objects(0x1400, 0x200 + number, 255, (0x6040_0010,)),  # as delivered: without speeds
            **pdo_objects(0x1800, 0x180 + number, 255, (0x6041_0010,)),
        }
        super().__init__(channel, number, objects, 0x0002_0192)
        self.node.add_read_callback(self._measured)
        self.node.add_write_callback(self._written)
        self.network.subscribe(0x200 + number, self._ordered)
        self.network.subscribe(0x701, self._heard)

    def _measured(self, *, index: int, subindex: int, od: ODVariable) -> int | None:
        return {0x6041: self._word, 0x6044: round(self.rpm), 0x6061: self._mode}.get(index)

    def _written(self, *, index: int, subindex: int, od: ODVariable, data: bytes) -> None:
        if index == 0x6060:
            self._mode = data[0]

    @property
    def _word(self) -> int:
        return next(word for word, state in STATES.items() if state == self.state)

    def _heard(self, cob: int, data: bytearray, timestamp: float) -> None:
        self._silent_s = 0.0

    def _ordered(self, cob: int, data: bytearray, timestamp: float) -> None:
        if not self.operational or self.of(0x1600, 0) != 2:
            return
        word, self._target = struct.unpack("<Hh", data)
        self.node.set_data(0x6042, 0, bytes(data[2:]))
        orders = {0x6: "ready", 0x7: "on", 0xF: "enabled"}
        if word & 0x82 == 0:
            self.state = "disabled"
        elif word & 0x86 == 2 and self.state == "enabled":
            self.state = "quick stop"
        elif self.state != "quick stop" and word & 0xF in orders:
            self.state = orders[word & 0xF]

    def tick(self, passed_s: float) -> None:
        watched_s = 1e-3 * (self.of(0x1016, 1) & 0xFFFF)
        self._silent_s += passed_s
        if watched_s and self._silent_s > watched_s and self.state == "enabled":
            self.state, self.quick_stops = "quick stop", self.quick_stops + 1
        target, rate = {"enabled": (self._target, self.of(0x6048, 1)), "quick stop": (0, 500)}.get(self.state, (0, 20))
        step = rate * passed_s
        self.rpm += max(-step, min(target - self.rpm, step))
        self._due_s -= passed_s
        if self._due_s <= 0 and self.of(0x1A00, 0) == 2:
            self._due_s += 0.01
            self.report(struct.pack("<Hh", self._word, round(self.rpm)))
