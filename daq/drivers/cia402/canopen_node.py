"""A CANopen node's end of the bus behind an slcan adapter: its answers to a host, independent of the motor.

Used by the simulated drive and by the stand-in for a drive of a log. `Adapter` answers the adapter's own commands,
`SdoServer` answers reads and writes of objects (expedited transfers), `NmtState` follows the network commands. Sources:
LAWICEL CAN232 manual; CiA 301, SDO protocol and NMT.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.profile import PROFILE_ACCELERATION, PROFILE_DECELERATION, VELOCITY, SpeedProfile
from daq.transports import slcan

Objects = dict[tuple[int, int], tuple[int, str]]
"""Value and struct format of each object by index and sub-index."""

NO_SUCH_OBJECT, WRONG_LENGTH, UNKNOWN_COMMAND = 0x06020000, 0x06070010, 0x05040001  # abort codes
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET, NMT_RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82

_NMT = {
    NMT_START: cia402.Heartbeat.OPERATIONAL,
    NMT_STOP: cia402.Heartbeat.STOPPED,
    NMT_PRE_OPERATIONAL: cia402.Heartbeat.PRE_OPERATIONAL,
    NMT_RESET: cia402.Heartbeat.PRE_OPERATIONAL,
    NMT_RESET_COMMUNICATION: cia402.Heartbeat.PRE_OPERATIONAL,
}


class Adapter:
    """The slcan adapter between a host and the bus.

    Attributes:
        open: whether the host has opened the bus; otherwise no frame is sent to the host.
    """

    def __init__(self) -> None:
        self.open: bool = False
        self._lines = slcan.LineDecoder(of_host=True)

    def receive(self, data: bytes) -> tuple[list[slcan.CanFrame], bytes]:
        """Take the host's text; return the frames for the bus, and the adapter's own answers."""
        found = self._lines.feed(data)
        answers = slcan.BEL.encode() * found.damaged
        for line in found.other_lines:
            if line[:1] in {"O", "C"}:
                self.open = line[:1] == "O"
            answers += {"V": b"V1013\r", "N": b"N4F1C\r"}.get(line[:1], b"\r")
        for frame in found.frames:
            answers += b"Z\r" if frame.extended else b"z\r"
        return found.frames, answers


class SdoServer:
    """Server of a node's objects.

    Args:
        objects: objects that can be read and written; changed in place.
        measured: functions that return the bytes of objects that are only read.
        written: called with index, sub-index and value after each write.
    """

    def __init__(
        self,
        objects: Objects,
        measured: Mapping[tuple[int, int], Callable[[], bytes | None]],
        written: Callable[[int, int, int], None] = lambda index, sub, value: None,
    ) -> None:
        self.objects: Objects = objects
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
            entry = self.objects.get((index, sub))
            if entry is None:
                return _abort(head, NO_SUCH_OBJECT)
            form = entry[1]
            if command & 1 and 4 - (command >> 2 & 3) != struct.calcsize(form):
                return _abort(head, WRONG_LENGTH)
            (value,) = struct.unpack_from(form, request, 4)
            self.objects[index, sub] = (value, form)
            self._written(index, sub, value)
            return b"\x60" + head + bytes(4)
        return _abort(head, UNKNOWN_COMMAND)

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
        self.state: cia402.Heartbeat = cia402.Heartbeat.PRE_OPERATIONAL
        self._node = node

    def follow(self, frame: slcan.CanFrame) -> int | None:
        """Take a frame; return its command if it is a network command for this node, otherwise None."""
        if frame.arbitration_id != 0 or len(frame.data) != 2 or frame.data[1] not in (0, self._node):
            return None
        command = frame.data[0]
        self.state = _NMT.get(command, self.state)
        return command


def drive_objects(node: int, profile: SpeedProfile = VELOCITY) -> Objects:
    """Return the minimum objects of a drive with initial values: ramps 100 rpm/s, no reports at rest."""
    ordered = profile.mapping(cia402.CONTROLWORD, profile.target)
    reported = profile.mapping(cia402.STATUSWORD, profile.actual)
    ramp = round(100 * profile.units_per_rpm)
    return {
        (cia402.RPDO1, 1): (cia402.cob_rpdo(1, node), "<I"),
        (cia402.RPDO1, 2): (255, "<B"),
        (cia402.RPDO1_MAPPING, 0): (2, "<B"),
        (cia402.RPDO1_MAPPING, 1): (ordered[0], "<I"),
        (cia402.RPDO1_MAPPING, 2): (ordered[1], "<I"),
        (cia402.TPDO1, 1): (cia402.cob_tpdo(1, node), "<I"),
        (cia402.TPDO1, 2): (255, "<B"),
        (cia402.TPDO1, 5): (0, "<H"),
        (cia402.TPDO1_MAPPING, 0): (2, "<B"),
        (cia402.TPDO1_MAPPING, 1): (reported[0], "<I"),
        (cia402.TPDO1_MAPPING, 2): (reported[1], "<I"),
        (0x1000, 0): (0x00020192, "<I"),
        (0x1001, 0): (0, "<B"),
        (cia402.CONSUMER_HEARTBEAT, 1): (0, "<I"),
        (cia402.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia402.CONTROLWORD, 0): (0, "<H"),
        (profile.target, 0): (0, "<h" if profile.bits == 16 else "<i"),
        (PROFILE_ACCELERATION, 0): (ramp, "<I"),
        (PROFILE_DECELERATION, 0): (ramp, "<I"),
        (cia402.VELOCITY_ACCELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_ACCELERATION, 2): (1, "<H"),
        (cia402.VELOCITY_DECELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_DECELERATION, 2): (1, "<H"),
        (cia402.MODE_OF_OPERATION, 0): (0, "<b"),
    }


def _abort(head: bytes, code: int) -> bytes:
    return b"\x80" + head + struct.pack("<I", code)
