# pyright: strict
"""A VESC of a log while it is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from daq.drivers.vesc import packets, wire


class PlayedVesc(PlayedDevice):
    """Says what it is; its answers to polls are those of the log, and it turns as it did.

    Args:
        identity: what it said of itself.
    """

    def __init__(self, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._decoder = packets.PacketDecoder()
        self._firmware = _firmware(identity)

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answers = b""
        for payload in self._decoder.feed(data).payloads:
            self.commands += 1
            command = wire.parse_command(payload)
            self.unfollowed += command is not None and command.what == wire.SET_RPM
            if payload[:1] == bytes([wire.FIRMWARE_VERSION]):
                answers += packets.packet(wire.pack_firmware(self._firmware))
        return answers


def _firmware(identity: Mapping[str, Any]) -> wire.Firmware:
    """What it said; where a log does not say it in a way that can be sent, a firmware whose answers are known."""
    try:
        major, minor = (int(part) for part in str(identity["firmware"]).split("."))
        found = wire.Firmware(major, minor, str(identity["hardware"]), str(identity["serial"]))
        wire.pack_firmware(found)
    except (KeyError, ValueError):
        return wire.Firmware(6, 5, "played", "00" * 12)
    return found
