"""Stand-in for a VESC on a CAN bus of a log while the log is played."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from daq.drivers.can_lines import Adapter, BothWays
from daq.drivers.played import PlayedDevice
from daq.drivers.vesc import wire as vesc
from daq.drivers.vesc.played import firmware_of
from daq.drivers.vesc_can import wire
from daq.drivers.vesc_can.settings import VescCan
from daq.transports.can_frames import encode


class _CommandsTo(Container[int]):
    """The identifiers of all commands to a controller."""

    def __init__(self, controller_id: int) -> None:
        self._number = controller_id

    def __contains__(self, arbitration_id: object) -> bool:
        return isinstance(arbitration_id, int) and wire.split(arbitration_id)[1] == self._number


class PlayedVescCan(PlayedDevice):
    """A VESC behind its adapter that reports its identity; its other messages, and so its speed, are those of the log.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: VescCan, identity: Mapping[str, Any]) -> None:
        self._bus = BothWays(_CommandsTo(settings.controller_id))
        super().__init__(self._bus)
        self._settings, self._adapter = settings, Adapter()
        self._firmware = vesc.pack_firmware(firmware_of(identity))

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._adapter.open

    def begin(self) -> None:
        """See PlayedDevice."""
        self._adapter.open = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. Commands to the adapter alone do not count as commands to the controller."""
        frames, out = self._adapter.receive(data), b""
        self.commands += len(frames)
        self._bus.host_is_there |= bool(frames)
        controller, host = self._settings.controller_id, self._settings.host_id
        for frame in frames:
            command, number = wire.split(frame.arbitration_id)
            if number != controller:
                continue
            self.unfollowed += command == wire.SET_RPM
            if wire.payload_of(frame) == bytes([vesc.FIRMWARE_VERSION]):
                out += encode(*(piece for piece in wire.pieces(self._firmware, controller, host)))
        return out
