"""A CANopen node's end of the bus: its answers to a host, independent of the kind of device.

Used by simulated nodes and by the stand-ins for nodes of a log. Source: CiA 301, SDO protocol (expedited transfers),
NMT, heartbeat and emergency.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType

from daq.drivers.canopen import cia301
from daq.transports.can_frames import CanFrame

Objects = dict[tuple[int, int], tuple[int, str]]
"""Value and struct format of each object by index and sub-index."""

NO_SUCH_OBJECT, WRONG_LENGTH, UNKNOWN_COMMAND = 0x06020000, 0x06070010, 0x05040001  # abort codes
READ_ONLY = 0x06010002
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL = 0x01, 0x02, 0x80
RESETS = (0x81, 0x82)
"""Network commands after which a node starts again: all of it, or its communication."""

_NMT = {
    NMT_START: cia301.Heartbeat.OPERATIONAL,
    NMT_STOP: cia301.Heartbeat.STOPPED,
    NMT_PRE_OPERATIONAL: cia301.Heartbeat.PRE_OPERATIONAL,
    **dict.fromkeys(RESETS, cia301.Heartbeat.PRE_OPERATIONAL),
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


class Node:
    """A node's end of the bus: its answers, its network state, its heartbeat and its emergencies.

    Args:
        number: node number.
        objects, measured, written: see SdoServer.

    Attributes:
        number: see above.
        sdo: its objects.
        state: NMT state, as in its heartbeat.
    """

    def __init__(
        self,
        number: int,
        objects: Objects,
        measured: Mapping[tuple[int, int], Callable[[], bytes | None]] = MappingProxyType({}),
        written: Callable[[int, int, int], None] = lambda index, sub, value: None,
    ) -> None:
        self.number: int = number
        self.sdo: SdoServer = SdoServer(objects, measured, written)
        self.state: cia301.Heartbeat = cia301.Heartbeat.PRE_OPERATIONAL
        self._beat_due_s = 0.0

    @property
    def operational(self) -> bool:
        """Whether it sends and takes process data."""
        return self.state == cia301.Heartbeat.OPERATIONAL

    def command(self, frame: CanFrame) -> int | None:
        """Return the network command in a frame, if there is one for this node, otherwise None."""
        for_it = frame.arbitration_id == 0 and len(frame.data) == 2 and frame.data[1] in (0, self.number)
        return frame.data[0] if for_it else None

    def answers(self, frame: CanFrame) -> list[CanFrame]:
        """Take a frame; return what the node answers. It follows network commands."""
        command = self.command(frame)
        if command is not None:
            self.state = _NMT.get(command, self.state)
            return [self.boot_up()] if command in RESETS else []
        if frame.arbitration_id == cia301.cob_sdo_request(self.number) and len(frame.data) == 8:
            return [CanFrame(cia301.cob_sdo_answer(self.number), self.sdo.answer(frame.data))]
        return []

    def boot_up(self) -> CanFrame:
        """Return the message of its start."""
        return CanFrame(cia301.cob_heartbeat(self.number), bytes([cia301.Heartbeat.BOOT_UP]))

    def heartbeat(self, now_s: float) -> list[CanFrame]:
        """Return the heartbeat if it is due."""
        period_s = self.sdo.objects.get((cia301.PRODUCER_HEARTBEAT, 0), (0, ""))[0] * 1e-3
        if not period_s or now_s < self._beat_due_s:
            return []
        self._beat_due_s = max(self._beat_due_s + period_s, now_s)
        return [CanFrame(cia301.cob_heartbeat(self.number), bytes([self.state]))]

    def emergency(self, code: int, register: int) -> CanFrame:
        """Return the emergency of an error code and an error register."""
        data = cia301.pack_emergency(cia301.Emergency(code, register, bytes(5)))
        return CanFrame(cia301.cob_emergency(self.number), data)


def _abort(head: bytes, code: int) -> bytes:
    return b"\x80" + head + struct.pack("<I", code)
