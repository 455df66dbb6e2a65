"""Stand-in for a VESC on a CAN bus of a log while the log is played."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import Any

from daq.drivers.can_lines import PlayedOnBus
from daq.transports.can_frames import CanFrame
from rig_drivers.vesc import wire as vesc
from rig_drivers.vesc.played import firmware_of
from rig_drivers.vesc_can import wire
from rig_drivers.vesc_can.settings import VescCan


class _CommandsTo(Container[int]):
    """The identifiers of all commands to a controller."""

    def __init__(self, controller_id: int) -> None:
        self._number = controller_id

    def __contains__(self, arbitration_id: object) -> bool:
        return isinstance(arbitration_id, int) and wire.split(arbitration_id)[1] == self._number


class PlayedVescCan(PlayedOnBus):
    """A VESC that reports its identity; its other messages, and so its speed, are those of the log.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: VescCan, identity: Mapping[str, Any]) -> None:
        super().__init__(_CommandsTo(settings.controller_id))
        self._settings, self._firmware = settings, vesc.pack_firmware(firmware_of(identity))

    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        """See PlayedOnBus."""
        command, number = wire.split(frame.arbitration_id)
        if number != self._settings.controller_id:
            return ()
        self.unfollowed += command == wire.SET_RPM
        asks = wire.payload_of(frame) == bytes([vesc.FIRMWARE_VERSION])
        return wire.pieces(self._firmware, number, self._settings.host_id) if asks else ()
