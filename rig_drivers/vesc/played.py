"""Stand-in for a VESC of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import Vesc


class PlayedVesc(PlayedDevice):
    """A VESC that reports its identity; its answers to polls, and thus the speed, are those of the log.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    def __init__(self, settings: Vesc, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._decoder = packets.PacketDecoder()
        self._firmware = firmware_of(identity)

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


def firmware_of(identity: Mapping[str, Any]) -> wire.Firmware:
    """Return the firmware of an identity; a known firmware if the identity is incomplete or invalid."""
    try:
        major, minor = (int(part) for part in str(identity["firmware"]).split("."))
        found = wire.Firmware(major, minor, str(identity["hardware"]), str(identity["serial"]))
        wire.pack_firmware(found)
    except (KeyError, ValueError):  # usual: the identity in the log is incomplete
        return wire.Firmware(6, 5, "played", "00" * 12)
    return found
