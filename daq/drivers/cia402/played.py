"""Stand-in for a CiA 402 drive of a log while the log is played."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any

from daq.drivers.can_lines import PlayedOnBus
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Node
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.drive_objects import drive_objects
from daq.drivers.cia402.profile import profile_of
from daq.drivers.cia402.settings import MotorDrive
from daq.transports.can_frames import CanFrame, decode


class PlayedDrive(PlayedOnBus):
    """A drive behind its adapter. It accepts settings and follows network commands; its speed is that of the log.

    Args:
        config: table of the drive in the rig file.
        identity: of the drive; it is not needed.
    """

    expects = "the network's start"

    def __init__(self, config: MotorDrive, identity: Mapping[str, Any]) -> None:
        super().__init__({cia301.cob_heartbeat(config.host_node_id)})
        self._host_beat = cia301.cob_heartbeat(config.host_node_id)
        self._profile = profile_of(config)
        self._reported = bytes(self._profile.size)
        objects = self._objects = drive_objects(config.node_id, self._profile)
        measured = {
            (cia402.STATUSWORD, 0): lambda: self._reported[:2],
            (self._profile.actual, 0): lambda: self._reported[2:],
            (cia402.MODE_DISPLAY, 0): lambda: struct.pack("<b", objects[cia402.MODE_OF_OPERATION, 0][0]),
        }
        self._node = Node(config.node_id, objects, measured, self._written)

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return super().sending and self._node.operational

    def begin(self) -> None:
        """See PlayedDevice."""
        super().begin()
        self._node.state = cia301.Heartbeat.OPERATIONAL

    def is_host(self, frame: CanFrame) -> bool:
        """See PlayedOnBus."""
        return frame.arbitration_id == self._host_beat

    def _pass(self, data: bytes) -> bytes:
        for frame in decode(data).frames:
            if frame.arbitration_id == cia301.cob_tpdo(1, self._node.number) and len(frame.data) >= self._profile.size:
                self._reported = frame.data[: self._profile.size]
        return super()._pass(data)

    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        """See PlayedOnBus."""
        data = frame.data
        yield from self._node.answers(frame)
        if frame.arbitration_id == cia301.cob_rpdo(1, self._node.number) and len(data) == self._profile.size:
            form = self._objects[self._profile.target, 0][1]
            self._objects[self._profile.target, 0] = (struct.unpack(form, data[2:])[0], form)
            self._turn(self._profile.unpack(data)[0])

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._turn(value)

    def _turn(self, controlword: int) -> None:
        """Count a command to operate, which a log cannot follow. Commands that end operation are not counted."""
        self.unfollowed += controlword & 0x0F == cia402.ENABLE_OPERATION
