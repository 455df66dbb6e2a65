"""A simulated CiA 402 drive behind an slcan adapter: SDO server, PDOs, heartbeats both ways, quick stop."""

from __future__ import annotations

import math
import struct

from daq.protocols import cia402, slcan
from daq.virtual_rig.motion import Motion
from rig_configs.schema import Drive

_TPDO_S = 0.01
_QUICK_STOP_RPM_S = 4000.0
_COAST_RPM_S = 30.0  # bearings and windage, when there is no torque
_RAD_S = math.pi / 30
_STATUS = {name: value for name, (_, value) in cia402.STATES.items()}
_HEARTBEAT_ERROR = 0x8130


class SimulatedDrive:
    """Turns the rotor as the wire says; stops it by itself when the host's heartbeat stays away."""

    def __init__(self, config: Drive, motion: Motion) -> None:
        self._config, self._motion, self._node = config, motion, config.node_id
        self._lines = slcan.LineDecoder()
        self._open = False
        self._nmt = cia402.Heartbeat.PRE_OPERATIONAL
        self.state = cia402.SWITCH_ON_DISABLED
        self._target_rpm = 0
        self._heard_s: float | None = None  # last host heartbeat; None until the first
        self._tpdo_due = self._heartbeat_due = 0.0
        self._objects: dict[tuple[int, int], tuple[int, str]] = {
            (0x1000, 0): (0x00020192, "<I"),
            (0x1001, 0): (0, "<B"),
            (0x1016, 1): (0, "<I"),
            (0x1017, 0): (0, "<H"),
            (0x1018, 1): (0x0000_0A11, "<I"),
            (0x1018, 4): (24601, "<I"),
            (0x6040, 0): (0, "<H"),
            (0x6042, 0): (0, "<h"),
            (0x6048, 1): (100, "<I"),
            (0x6048, 2): (1, "<H"),
            (0x6049, 1): (100, "<I"),
            (0x6049, 2): (1, "<H"),
            (0x6060, 0): (0, "<b"),
            (0x6085, 0): (int(_QUICK_STOP_RPM_S), "<I"),
        }
        self._out: list[slcan.CanFrame] = []

    @property
    def speed_rpm(self) -> float:
        """True speed."""
        return self._motion.speed_rad_s / _RAD_S

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take slcan text from the host; returns the adapter's answers."""
        found = self._lines.feed(data)
        answers = b"\x07" * found.damaged
        for line in found.other_lines:
            if line[:1] in {"O", "C"}:
                self._open = line[:1] == "O"
            answers += b"V1013\r" if line[:1] == "V" else b"N4F1C\r" if line[:1] == "N" else b"\r"
        for frame in found.frames:
            answers += b"Z\r" if frame.extended else b"z\r"
            self._frame(frame, now_s)
        return answers + self._take()

    def _take(self) -> bytes:
        frames, self._out = self._out, []
        return b"".join(slcan.encode(f) for f in frames) if self._open else b""

    def _frame(self, frame: slcan.CanFrame, now_s: float) -> None:
        identifier, data = frame.arbitration_id, frame.data
        if identifier == 0 and len(data) == 2 and data[1] in (0, self._node):
            self._set_nmt(data[0])
        elif identifier == cia402.cob_sdo_request(self._node) and len(data) == 8:
            self._out.append(slcan.CanFrame(cia402.cob_sdo_answer(self._node), self._sdo(data)))
        elif identifier == cia402.cob_rpdo(1, self._node) and len(data) == 4:
            if self._nmt == cia402.Heartbeat.OPERATIONAL:
                control, target = cia402.unpack_rpdo1(data)
                self._target_rpm = target
                self._control(control)
        elif identifier == cia402.cob_heartbeat(self._objects[0x1016, 1][0] >> 16 & 0x7F):
            self._heard_s = now_s

    def _set_nmt(self, command: int) -> None:
        states = {
            1: cia402.Heartbeat.OPERATIONAL,
            2: cia402.Heartbeat.STOPPED,
            0x80: cia402.Heartbeat.PRE_OPERATIONAL,
            0x81: cia402.Heartbeat.PRE_OPERATIONAL,
            0x82: cia402.Heartbeat.PRE_OPERATIONAL,
        }
        self._nmt = states.get(command, self._nmt)
        if command in (2, 0x81, 0x82) and self.state == cia402.OPERATION_ENABLED:
            self._quick_stop()
        if command in (0x81, 0x82):
            self._heard_s = None
            self._out.append(slcan.CanFrame(cia402.cob_heartbeat(self._node), b"\x00"))

    def _sdo(self, request: bytes) -> bytes:
        command, index, sub = struct.unpack_from("<BHB", request)
        entry = self._objects.get((index, sub))
        head = struct.pack("<HB", index, sub)
        if command == 0x40:
            value = self._read(index, sub)
            if value is None:
                return b"\x80" + head + struct.pack("<I", 0x06020000)
            return bytes([0x43 | (4 - len(value)) << 2]) + head + value.ljust(4, b"\0")
        if command & 0xE3 == 0x23 or command & 0xE2 == 0x22:
            if entry is None:
                return b"\x80" + head + struct.pack("<I", 0x06020000)
            size = struct.calcsize(entry[1])
            if command & 1 and 4 - (command >> 2 & 3) != size:
                return b"\x80" + head + struct.pack("<I", 0x06070010)
            (value,) = struct.unpack_from(entry[1], request, 4)
            self._objects[index, sub] = (value, entry[1])
            if (index, sub) == (0x6040, 0):
                self._control(value)
            if (index, sub) == (0x6042, 0):
                self._target_rpm = value
            return b"\x60" + head + b"\0\0\0\0"
        return b"\x80" + head + struct.pack("<I", 0x05040001)

    def _read(self, index: int, sub: int) -> bytes | None:
        if (index, sub) == (0x6041, 0):
            return struct.pack("<H", _STATUS[self.state])
        if (index, sub) == (0x6044, 0):
            return struct.pack("<h", round(self.speed_rpm))
        if (index, sub) == (0x6061, 0):
            index = 0x6060
        entry = self._objects.get((index, sub))
        return None if entry is None else struct.pack(entry[1], entry[0])

    def _control(self, word: int) -> None:
        s = self.state
        if word & 0x82 == 0x00:
            self.state = cia402.SWITCH_ON_DISABLED if s != cia402.FAULT else s
        elif word & 0x86 == 0x02:
            if s == cia402.OPERATION_ENABLED:
                self._quick_stop()
        elif word & 0x80:
            self.state = cia402.SWITCH_ON_DISABLED if s == cia402.FAULT else s
        elif s == cia402.SWITCH_ON_DISABLED and word & 0x87 == 0x06:
            self.state = cia402.READY
        elif s == cia402.READY and word & 0x87 == 0x07:
            self.state = cia402.SWITCHED_ON
        elif s in (cia402.READY, cia402.SWITCHED_ON) and word & 0x8F == 0x0F:
            self.state = cia402.OPERATION_ENABLED
        elif s in (cia402.OPERATION_ENABLED, cia402.SWITCHED_ON) and word & 0x87 == 0x06:
            self.state = cia402.READY

    def _quick_stop(self) -> None:
        self.state = cia402.QUICK_STOP_ACTIVE

    def step(self, now_s: float) -> bytes:
        """Drive logic up to now: watchdog, ramps, cyclic frames."""
        self._watch(now_s)
        enabled = self.state == cia402.OPERATION_ENABLED
        in_mode = self._objects[0x6060, 0][0] == cia402.MODE_VELOCITY
        target = self._target_rpm if enabled and in_mode else 0
        sub = 0x6048 if abs(target) * _RAD_S >= abs(self._motion.speed_rad_s) else 0x6049
        change, seconds = self._objects[sub, 1][0], self._objects[sub, 2][0]
        stopping = self.state == cia402.QUICK_STOP_ACTIVE
        ramp = change / max(1, seconds) if enabled else _QUICK_STOP_RPM_S if stopping else _COAST_RPM_S
        self._motion.target_rad_s = target * _RAD_S
        self._motion.ramp_rad_s2 = ramp * _RAD_S
        self._motion.braking = stopping
        if self.state == cia402.QUICK_STOP_ACTIVE and abs(self._motion.speed_rad_s) < 0.01:
            self.state = cia402.SWITCH_ON_DISABLED
        self._cyclic(now_s)
        return self._take()

    def _watch(self, now_s: float) -> None:
        limit_ms = self._objects[0x1016, 1][0] & 0xFFFF
        if not limit_ms or self._heard_s is None or now_s - self._heard_s <= limit_ms * 1e-3:
            return
        self._heard_s = None
        if self.state == cia402.OPERATION_ENABLED:
            self._quick_stop()
        data = cia402.pack_emergency(cia402.Emergency(_HEARTBEAT_ERROR, 0x11, bytes(5)))
        self._out.append(slcan.CanFrame(cia402.cob_emergency(self._node), data))

    def _cyclic(self, now_s: float) -> None:
        every = self._objects[0x1017, 0][0] * 1e-3
        if every and now_s >= self._heartbeat_due:
            self._heartbeat_due = max(self._heartbeat_due + every, now_s - every)
            self._out.append(slcan.CanFrame(cia402.cob_heartbeat(self._node), bytes([self._nmt])))
        if self._nmt != cia402.Heartbeat.OPERATIONAL:
            self._tpdo_due = now_s
            return
        while now_s >= self._tpdo_due:
            self._tpdo_due = max(self._tpdo_due + _TPDO_S, now_s - 5 * _TPDO_S)
            data = cia402.pack_tpdo1(_STATUS[self.state], round(self.speed_rpm))
            self._out.append(slcan.CanFrame(cia402.cob_tpdo(1, self._node), data))
