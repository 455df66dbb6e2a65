"""Stand-in for an ODrive of a log while the log is played."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from daq.drivers.can_lines import PlayedOnBus
from daq.transports.can_frames import CanFrame, decode
from rig_drivers.odrive import wire
from rig_drivers.odrive.settings import Odrive

_UNKNOWN = wire.Version((0, 0, 0), (0, 6, 0))


class PlayedOdrive(PlayedOnBus):
    """An ODrive behind its adapter. It reports its version and serial number; its speed and state are those of the log.

    When the bus is opened it sends the newest heartbeat and estimates of the log, for which the opening waits.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: Odrive, identity: Mapping[str, Any]) -> None:
        super().__init__({wire.identifier(settings.node_id, command) for command in range(32)})
        self._node = settings.node_id
        self._answers = _answers(settings, identity)
        self._reports = {
            wire.HEARTBEAT: self._frame(wire.HEARTBEAT, wire.pack_idle()),
            wire.ESTIMATES: self._frame(wire.ESTIMATES, bytes(8)),
        }

    def first_frames(self) -> Iterable[CanFrame]:
        """See PlayedOnBus: the opening waits for them."""
        return self._reports.values()

    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        """See PlayedOnBus."""
        node, command = wire.split(frame.arbitration_id)
        if node != self._node:
            return
        self.unfollowed += command == wire.AXIS_STATE and wire.parse_state(frame) == wire.CLOSED_LOOP
        if frame.remote and command in self._answers:
            yield self._frame(command, self._answers[command])

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(wire.identifier(self._node, command), data)

    def _pass(self, data: bytes) -> bytes:
        for frame in decode(data).frames:
            node, command = wire.split(frame.arbitration_id)
            if node == self._node and command in self._reports and not frame.remote:
                self._reports[command] = frame
        return super()._pass(data)


def _answers(settings: Odrive, identity: Mapping[str, Any]) -> dict[int, bytes]:
    """Return the answers to requests by command; known ones if the identity is incomplete or invalid."""
    if settings.firmware == "0.5":
        return {}
    serial = str(identity.get("serial", ""))
    if len(serial) != 12 or not all(digit in "0123456789ABCDEF" for digit in serial):
        serial = settings.serial or "0" * 12
    try:
        hardware = _three(identity["hardware"])
        version = wire.Version(hardware, _three(identity["firmware"]))
        answer = wire.pack_version(version)
    except (KeyError, ValueError):  # usual: the identity in the log is incomplete
        answer = wire.pack_version(_UNKNOWN)
    return {wire.VERSION: answer, wire.ADDRESS: wire.pack_address(settings.node_id, serial)}


def _three(text: Any) -> tuple[int, int, int]:
    first, second, third = (int(part) for part in str(text).split("."))
    return first, second, third
