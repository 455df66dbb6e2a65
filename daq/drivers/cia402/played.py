"""Stand-in for a CiA 402 drive of a log while the log is played."""

from __future__ import annotations

import re
import struct

from daq.channels import RX
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.canopen_node import (
    NMT_RESET,
    NMT_RESET_COMMUNICATION,
    Adapter,
    NmtState,
    SdoServer,
    drive_objects,
)
from daq.drivers.cia402.profile import profile_of
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.played import PlayedDevice
from daq.transports import slcan

_LINE_ENDS = b"\r\x07"
_MAX_TAIL_BYTES = 4096  # bytes without an end of line that are held back


class BothWays:
    """Filter for a CAN bus, which carries both directions: the host's frames are inserted between the drive's lines.

    A read may end in the middle of a line. The incomplete line is held until its end, so that no frame of the host is
    inserted into it; the drive's line was not complete before that frame either. Commands of the host to its own
    adapter (open, close, bit rate) are not on the bus and are not played.

    Args:
        host_node_id: node number of the recorded host.

    Attributes:
        host_is_there: whether a host has replaced the recorded one; then the recorded heartbeats are omitted.
    """

    def __init__(self, host_node_id: int) -> None:
        self.host_is_there = False
        self._beat = cia402.cob_heartbeat(host_node_id)
        self._host = slcan.LineDecoder(of_host=True)
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            frames = self._host.feed(data).frames
            omitted = self._beat if self.host_is_there else None
            return b"".join(slcan.encode(frame) for frame in frames if frame.arbitration_id != omitted)
        line = self._tail + data
        end = 1 + max(line.rfind(_LINE_ENDS[:1]), line.rfind(_LINE_ENDS[1:]))
        if len(line) - end > _MAX_TAIL_BYTES:
            end = len(line)
        self._tail = line[end:]
        return line[:end]

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        tail, self._tail = self._tail, b""
        return tail


class PlayedDrive(PlayedDevice):
    """A drive behind its adapter. It accepts settings and follows network commands; its speed is that of the log.

    Args:
        config: table of the drive in the rig file.
    """

    expects = "the network's start"

    def __init__(self, config: MotorDrive) -> None:
        self._bus = BothWays(config.host_node_id)
        super().__init__(self._bus)
        self._node, self._host_beat = config.node_id, cia402.cob_heartbeat(config.host_node_id)
        self._adapter, self._nmt = Adapter(), NmtState(config.node_id)
        self._profile = profile_of(config)
        size = self._profile.size
        self._report = re.compile(
            f"t{cia402.cob_tpdo(1, config.node_id):03X}[{size}-8]([0-9A-Fa-f]{{{2 * size}}})".encode()
        )
        self._reported = bytes(size)
        objects = drive_objects(config.node_id, self._profile)
        measured = {
            (cia402.STATUSWORD, 0): lambda: self._reported[:2],
            (self._profile.actual, 0): lambda: self._reported[2:],
            (cia402.MODE_DISPLAY, 0): lambda: struct.pack("<b", objects[cia402.MODE_OF_OPERATION, 0][0]),
        }
        self._sdo = SdoServer(objects, measured, self._written)

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._adapter.open and self._nmt.state == cia402.Heartbeat.OPERATIONAL

    def begin(self) -> None:
        """See PlayedDevice."""
        self._adapter.open, self._nmt.state = True, cia402.Heartbeat.OPERATIONAL

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. Commands to the adapter alone do not count as commands to the drive."""
        frames, answers = self._adapter.receive(data)
        self.commands += len(frames)
        self._bus.host_is_there |= any(frame.arbitration_id == self._host_beat for frame in frames)
        sent = b"".join(slcan.encode(answer) for frame in frames if (answer := self._answer(frame)) is not None)
        return answers + sent if self._adapter.open else answers

    def _pass(self, data: bytes) -> bytes:
        if reports := self._report.findall(data):
            self._reported = bytes.fromhex(reports[-1].decode())
        return super()._pass(data)

    def _answer(self, frame: slcan.CanFrame) -> slcan.CanFrame | None:
        identifier, data = frame.arbitration_id, frame.data
        if self._nmt.follow(frame) in (NMT_RESET, NMT_RESET_COMMUNICATION):
            return slcan.CanFrame(cia402.cob_heartbeat(self._node), bytes([cia402.Heartbeat.BOOT_UP]))
        if identifier == cia402.cob_sdo_request(self._node) and len(data) == 8:
            return slcan.CanFrame(cia402.cob_sdo_answer(self._node), self._sdo.answer(data))
        if identifier == cia402.cob_rpdo(1, self._node) and len(data) == self._profile.size:
            self._turn(self._profile.unpack(data)[0])
        return None

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._turn(value)

    def _turn(self, controlword: int) -> None:
        """Count a command to operate, which a log cannot follow. Commands that end operation are not counted."""
        self.unfollowed += controlword & 0x0F == cia402.ENABLE_OPERATION
