"""A converter's pipeline with the requests and answers on its line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.modbus_converter import wire
from rig_drivers.modbus_converter.settings import ModbusConverter
from rig_drivers.modbus_converter.stream import ConverterPipeline


def settings(**given: Any) -> ModbusConverter:
    return ModbusConverter.model_validate({"driver": "modbus_converter", "port": "p", **given})


def crc(data: bytes) -> bytes:
    """CRC-16 of Modbus, bit by bit, low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def frame(text: str) -> bytes:
    data = bytes.fromhex(text)
    return data + crc(data)


POLL = wire.encode(wire.Request(1, 3, 0x2100, 4))


def report(status: int = 0x11, fault: int = 0, counts: int = 1000) -> bytes:
    return frame(f"01 03 08 {status:04x} {fault:04x} 0000 {counts:04x}")


def write_of(register: int, *values: int, function: int = 6) -> bytes:
    return wire.encode(wire.Request(1, function, register, len(values), values))


class Line:
    """A pipeline with what was fed to it."""

    def __init__(self, **given: Any) -> None:
        self.settings = settings(**given)
        self.pipeline = ConverterPipeline("drive", self.settings, {})
        self.now_ns = 0
        self.items: list[Batch | DeviceEvent] = []

    def ask(self, data: bytes = POLL, after_ms: float = 50) -> None:
        self._feed(TX, data, after_ms)

    def hear(self, data: bytes, after_ms: float = 5) -> None:
        self._feed(RX, data, after_ms)

    def _feed(self, direction: int, data: bytes, after_ms: float) -> None:
        self.now_ns += round(after_ms * 1_000_000)
        self.items += self.pipeline.feed(direction, data, self.now_ns)

    def poll(self, after_ms: float = 50, **given: int) -> None:
        self.ask(after_ms=after_ms)
        self.hear(report(**given))

    def write(self, register: int, value: int) -> None:
        self.ask(write_of(register, value))
        self.hear(write_of(register, value))

    def read(self, register: int, *values: int | None, echo: bool = False, after_ms: float = 50) -> None:
        """Read registers; no answer comes if a value is None."""
        request = wire.encode(wire.Request(1, 3, register, len(values)))
        self.ask(request, after_ms)
        if None not in values:
            words = "".join(f"{value:04x}" for value in values)
            self.hear(request * echo + frame(f"01 03 {2 * len(values):02x} {words}"))

    def blocks(self, words: Mapping[int, int], lost: int | None = None, *, echo: bool = False) -> None:
        """Read the blocks of a report; the answer to the block with the register `lost` does not come."""
        for first, count in self.settings.blocks:
            numbers = range(first, first + count)
            self.read(first, *(None if number == lost else words.get(number, 0) for number in numbers), echo=echo)

    def column(self, name: str = "speed_rpm") -> list[float]:
        return [float(item.columns[name][0]) for item in self.items if isinstance(item, Batch)]

    def events(self, *kinds: str) -> list[tuple[str, Mapping[str, Any]]]:
        return [(item.text, item.facts) for item in self.items if isinstance(item, DeviceEvent) and item.kind in kinds]

    def kinds(self) -> list[str]:
        return [item.kind for item in self.items if isinstance(item, DeviceEvent) and item.kind != "reply"]

    def lost(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}
