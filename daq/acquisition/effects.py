"""Effects: what the core of the acquisition decides and the session carries out, in their sequence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.items import Batch, DeviceEvent


@dataclass(frozen=True)
class Keep:
    """Write bytes and the items decoded from them to the log, both or neither."""

    device: str
    direction: int
    data: bytes
    items: tuple[Batch | DeviceEvent, ...]
    host_ns: int


@dataclass(frozen=True)
class Happened:
    """Forward an event of a device to the observers and to the dialogue that waits for it."""

    event: DeviceEvent


@dataclass(frozen=True)
class Note:
    """Write an event of the host to the log."""

    event: DeviceEvent
    host_ns: int


@dataclass(frozen=True)
class WriteHealth:
    """Write a health report to the log."""

    facts: Mapping[str, Any]
    host_ns: int


@dataclass(frozen=True)
class Warn:
    """Show a message to the operator immediately."""

    text: str


@dataclass(frozen=True)
class StopRotor:
    """Stop the rotor with the drive as fast as possible. Without a drive nothing happens."""


Effect = Keep | Happened | Note | WriteHealth | Warn | StopRotor
