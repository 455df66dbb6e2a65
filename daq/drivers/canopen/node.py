"""A CANopen node's end of the bus: its answers to a host, independent of the kind of device.

Used by the simulated drive and by the stand-in for a drive of a log. `SdoServer` answers reads and writes of objects
(expedited transfers), `NmtState` follows the network commands. Source: CiA 301, SDO protocol and NMT.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from daq.drivers.canopen import cia301
from daq.transports.can_frames import CanFrame

Objects = dict[tuple[int, int], tuple[int, str]]
"""Value and struct format of each object by index and sub-index."""

NO_SUCH_OBJECT, WRONG_LENGTH, UNKNOWN_COMMAND = 0x06020000, 0x06070010, 0x05040001  # abort codes
READ_ONLY = 0x06010002
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET, NMT_RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82

_NMT = {
    NMT_START: cia301.Heartbeat.OPERATIONAL,
    NMT_STOP: cia301.Heartbeat.STOPPED,
    NMT_PRE_OPERATIONAL: cia301.Heartbeat.PRE_OPERATIONAL,
    NMT_RESET: cia301.Heartbeat.PRE_OPERATIONAL,
    NMT_RESET_COMMUNICATION: cia301.Heartbeat.PRE_OPERATIONAL,
}


class SdoServer:
    """Server of a node's objects.

    Args:
        objects: objects that can be read and written; changed in place.
        measured: functions that return the bytes of objects that are only read.
        written: called with index, sub-index and value after each write.

    Attributes:
        objects: see above.
        fixed: objects that it refuses to change, by index and sub-index.
    """

    def __init__(
        self,
        objects: Objects,
        measured: Mapping[tuple[int, int], Callable[[], bytes | None]],
        written: Callable[[int, int, int], None] = lambda index, sub, value: None,
    ) -> None:
        self.objects: Objects = objects
        self.fixed: set[tuple[int, int]] = set()
        self._measured, self._written = measured, written

    def answer(self, request: bytes) -> bytes:
        """Return the 8 bytes of the answer to the 8 bytes of a request."""
        command, index, sub = struct.unpack_from("<BHB", request)
        head = struct.pack("<HB", index, sub)
        if command == 0x40:
            value = self._read(index, sub)
            if value is None:
                return _abort(head, NO_SUCH_OBJECT)
            return bytes([0x43 | (4 - len(value)) << 2]) + head + value.ljust(4, b"\0")
        if command & 0xE3 == 0x23 or command & 0xE2 == 0x22:
            abort = self._write(index, sub, request)
            return b"\x60" + head + bytes(4) if abort is None else _abort(head, abort)
        return _abort(head, UNKNOWN_COMMAND)

    def _write(self, index: int, sub: int, request: bytes) -> int | None:
        """Carry out a write; return its abort code, None if it was carried out."""
        entry = self.objects.get((index, sub))
        if entry is None:
            return NO_SUCH_OBJECT
        if (index, sub) in self.fixed:
            return READ_ONLY
        command, form = request[0], entry[1]
        if command & 1 and 4 - (command >> 2 & 3) != struct.calcsize(form):
            return WRONG_LENGTH
        (value,) = struct.unpack_from(form, request, 4)
        self.objects[index, sub] = (value, form)
        self._written(index, sub, value)
        return None

    def _read(self, index: int, sub: int) -> bytes | None:
        measured = self._measured.get((index, sub))
        if measured is not None:
            return measured()
        entry = self.objects.get((index, sub))
        return None if entry is None else struct.pack(entry[1], entry[0])


class NmtState:
    """Network state of a node, which follows network commands.

    Attributes:
        state: NMT state, as in the node's heartbeat.
    """

    def __init__(self, node: int) -> None:
        self.state: cia301.Heartbeat = cia301.Heartbeat.PRE_OPERATIONAL
        self._node = node

    def follow(self, frame: CanFrame) -> int | None:
        """Take a frame; return its command if it is a network command for this node, otherwise None."""
        if frame.arbitration_id != 0 or len(frame.data) != 2 or frame.data[1] not in (0, self._node):
            return None
        command = frame.data[0]
        self.state = _NMT.get(command, self.state)
        return command


def _abort(head: bytes, code: int) -> bytes:
    return b"\x80" + head + struct.pack("<I", code)
