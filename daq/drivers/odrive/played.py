"""Stand-in for an ODrive of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.can_lines import Adapter, BothWays
from daq.drivers.odrive import wire
from daq.drivers.odrive.settings import Odrive
from daq.drivers.played import PlayedDevice
from daq.transports.can_frames import CanFrame, FrameDecoder, encode

_UNKNOWN = wire.Version((0, 0, 0), (0, 6, 0))


class PlayedOdrive(PlayedDevice):
    """An ODrive behind its adapter. It reports its version and serial number; its speed and state are those of the log.

    When the bus is opened it sends the newest heartbeat and estimates of the log, for which the opening waits.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: Odrive, identity: Mapping[str, Any]) -> None:
        self._bus = BothWays({wire.identifier(settings.node_id, command) for command in range(32)})
        super().__init__(self._bus)
        self._node, self._adapter = settings.node_id, Adapter()
        self._answers = _answers(settings, identity)
        self._reports = {
            wire.HEARTBEAT: encode(self._frame(wire.HEARTBEAT, wire.pack_idle())),
            wire.ESTIMATES: encode(self._frame(wire.ESTIMATES, bytes(8))),
        }
        self._lines = FrameDecoder()

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._adapter.open

    def begin(self) -> None:
        """See PlayedDevice."""
        self._adapter.open = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. Commands to the adapter alone do not count as commands to the controller."""
        was_open = self._adapter.open
        frames, out = self._adapter.receive(data), b""
        if self._adapter.open and not was_open:
            out += b"".join(self._reports.values())  # the opening waits for them
        self.commands += len(frames)
        self._bus.host_is_there |= bool(frames)
        for frame in frames:
            node, command = wire.split(frame.arbitration_id)
            if node != self._node:
                continue
            self.unfollowed += command == wire.AXIS_STATE and wire.parse_state(frame) == wire.CLOSED_LOOP
            if frame.remote and command in self._answers:
                out += encode(self._frame(command, self._answers[command]))
        return out

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(wire.identifier(self._node, command), data)

    def _pass(self, data: bytes) -> bytes:
        for frame in self._lines.feed(data).frames:
            node, command = wire.split(frame.arbitration_id)
            if node == self._node and command in self._reports and not frame.remote:
                self._reports[command] = encode(frame)
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
