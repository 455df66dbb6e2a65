"""A simulated LabJack T7: its registers, its inputs, and a stream in a buffer that overflows.

The pulse of the tachometer is that of a sensor with a finite flank: it rises within some degrees around the index.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from daq.drivers.labjack.settings import AnalogueLaser, AnalogueQuantity, LabJack, Tachometer
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World

Array = NDArray[np.floating[Any]]

_FLASH_AT = 0x3C4000
_ZERO, _SLOPE_V = 33530.0, 3.1586e-4  # of a count at ±10 V: not the nominal ones, so that they must be read
_HEAD = struct.Struct(">HHHBB")
_FLANK_RAD, _PULSE_RAD = math.radians(4.0), math.radians(30.0)
_PULSE_V = 5.0
_QUIET_V = 2e-4  # noise of inputs that are no lasers
_BLOCKED_V = 10.2
_NO_ADDRESS, _NO_VALUE, _FAILED = 2, 3, 4
_NOT_RUNNING, _ACTIVE, _LIST_INVALID, _RATE_INVALID, _BUFFER_INVALID, _TARGET_INVALID = (
    2620,
    2605,
    2607,
    2608,
    2615,
    2612,
)
_MOST_SAMPLES_PER_S = 100_000
_MOST_PENDING_BYTES = 4096


class _Refused(Exception):
    """A request that the device refuses.

    Args:
        exception: exception of Modbus.
        detail: the device's own error number.
    """

    def __init__(self, exception: int, detail: int) -> None:
        super().__init__(exception, detail)
        self.exception, self.detail = exception, detail


class _Buffer:
    """The device's buffer: scans that wait, and what was skipped while it was full."""

    def __init__(self, size_bytes: int, inputs: int, separator_counts: bool) -> None:
        self.data = bytearray()
        self.status, self.info = 0, 0
        self._size, self._scan_bytes, self._separator_counts = size_bytes, 2 * inputs, separator_counts
        self._skipped = 0

    def put(self, scans: NDArray[np.uint16]) -> None:
        """Store scans. Without room the device skips them until all that wait have been read."""
        if self.status == 2940 and not self.data and len(scans):
            stated = self._skipped - (0 if self._separator_counts else 1)
            self.status, self.info = (2941, stated) if stated < 2**16 else (2943, 2**16 - 1)
            self._skipped = 0
            self.data += b"\xff" * self._scan_bytes
        room = (self._size - len(self.data)) // self._scan_bytes
        if self.status == 2940 or room < len(scans):
            kept = 0 if self.status == 2940 else room
            self.skip(len(scans) - kept)
            scans = scans[:kept]
        self.data += scans.astype(">u2").tobytes()

    def skip(self, count: int) -> None:
        """Skip scans as a full buffer does."""
        self.status = 2940
        self._skipped += count

    def take(self, samples: int) -> bytes:
        """Return the registers of a stream read."""
        scans = min(2 * samples, len(self.data)) // self._scan_bytes
        data = bytes(self.data[: scans * self._scan_bytes])
        del self.data[: len(data)]
        head = struct.pack(">4H", len(data) // 2, len(self.data), self.status, self.info)
        if self.status in (2941, 2943):
            self.status, self.info = 0, 0
        return head + data + bytes(2 * samples - len(data))


class SimulatedLabJack(FarEnd):
    """One device on its connection.

    Args:
        settings: table of the device in the rig file.
        beams: beams of the lasers by name; all have the device's clock.
        serial: serial number.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the lasers' beams are blocked: their outputs are beyond the range"),
        "deaf": FaultKind("it ignores every request, so that its buffer fills"),
        "skips": FaultKind("it skips scans as with a full buffer", 400, None, "how many", (1, 1e5)),
        "overlap": FaultKind("a scan overlaps the next one: the stream stops", 1, None),
        "blank": FaultKind("its flash has no calibration constants"),
        "other": FaultKind("it is another device", 470_099_999, None, "its serial number", (1, 2**32 - 1)),
    }

    def __init__(self, settings: LabJack, beams: Mapping[str, Beam], clock: Beam, serial: int) -> None:
        self._settings, self._beams, self._clock = settings, beams, clock
        self._serial = settings.serial_number or serial
        self._faults = dict.fromkeys(("blocked", "deaf", "blank"), False)
        self._pending = b""
        self._start()

    def _start(self) -> None:
        self._registers: dict[int, bytes] = {}
        self._outputs: set[int] = set()  # digital lines that are outputs
        self._error = 0
        self._stream: _Buffer | None = None
        self._rate_Hz = 0.0

    @classmethod
    def of(cls, device: str, settings: LabJack, world: World) -> SimulatedLabJack:
        """Make the device of a simulated rig."""
        clock = Beam.unmoved()
        clock.clock, clock.rng = world.clock(device), world.rng(f"noise {device}")
        beams = {name: Beam.of(f"{device} {name}", laser, world) for name, laser in settings.lasers.items()}
        for beam in beams.values():
            beam.clock = clock.clock
        return cls(settings, beams, clock, 470_010_000 + world.number(device, ""))

    # --- commands ------------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float = 0.0) -> bytes:
        """Take bytes of requests, split at any place, and return the answers."""
        self._pending += data
        out = b""
        while len(self._pending) >= _HEAD.size:
            number, protocol, length, unit, function = _HEAD.unpack_from(self._pending)
            if protocol or not 2 <= length <= 260 or function != 76:
                self._pending = self._pending[1:]
                continue
            if len(self._pending) < 6 + length:
                break
            body, self._pending = self._pending[_HEAD.size : 6 + length], self._pending[6 + length :]
            if self._faults["deaf"]:
                continue
            try:
                answer, kind = self._carry_out(body), 76
            except _Refused as refused:
                self._error = refused.detail
                answer, kind = bytes([refused.exception]), 76 | 0x80
            out += _HEAD.pack(number, 0, 2 + len(answer), unit, kind) + answer
        self._pending = self._pending[-_MOST_PENDING_BYTES:]
        return out

    def _carry_out(self, body: bytes) -> bytes:
        out, at = b"", 0
        while at + 4 <= len(body):
            writes, address, count = struct.unpack_from(">BHB", body, at)
            at += 4
            if not writes:
                out += self._read(address, count)
                continue
            self._write(address, body[at : at + 2 * count])
            at += 2 * count
        return out

    def _read(self, address: int, count: int) -> bytes:
        facts = {
            4002: struct.pack(">f", self._rate_Hz),
            55000: struct.pack(">H", self._error),
            60000: struct.pack(">f", 7.0),
            60004: struct.pack(">f", 1.0299),
            60028: struct.pack(">I", self._serial),
        }
        match address:
            case 61812:
                at = self._number(61810) - _FLASH_AT
                if not 0 <= at <= 164 - 2 * count:
                    raise _Refused(_FAILED, 2350)
                return self._flash()[at : at + 2 * count]
            case 4500:
                if self._stream is None:
                    raise _Refused(_FAILED, _NOT_RUNNING)
                answer = self._stream.take(count - 4)
                if self._stream.status == 2942:
                    self._stream = None
                return answer
            case _ if address in facts:
                return facts[address]
            case _ if 2000 <= address < 2016:
                self._outputs.discard(address - 2000)
                return b"\0\0"
            case _:
                raise _Refused(_NO_ADDRESS, 0)

    def _flash(self) -> bytes:
        if self._faults["blank"]:
            return b"\xff" * 164
        sets = [(_SLOPE_V / share, -_SLOPE_V / share, _ZERO, -_ZERO * _SLOPE_V / share) for share in (1, 10, 100, 1000)]
        return struct.pack(">32f", *(2 * [value for each in sets for value in each])) + bytes(36)

    def _number(self, address: int) -> int:
        return int.from_bytes(self._registers.get(address, b"\0\0\0\0"), "big")

    def _write(self, address: int, data: bytes) -> None:
        if address == 4990:
            self._enable(any(data))
        elif 4002 <= address < 4990 and self._stream is not None:
            raise _Refused(_FAILED, _ACTIVE)
        elif address == 4100:
            for place in range(0, len(data), 4):
                self._registers[4100 + place // 2] = data[place : place + 4]
        elif 2000 <= address < 2016:
            self._outputs.add(address - 2000)
        elif 4002 <= address < 4026 or 40000 <= address < 41014 or address in (48005, 61810):
            self._registers[address] = data
        else:
            raise _Refused(_NO_ADDRESS, 0)

    def _enable(self, on: bool) -> None:
        if on == (self._stream is not None):
            raise _Refused(_FAILED, _ACTIVE if on else _NOT_RUNNING)
        if not on:
            self._stream = None
            return
        inputs, size = self._number(4004), self._number(4012)
        listed = tuple(self._number(4100 + 2 * place) for place in range(inputs))
        (rate,) = struct.unpack(">f", self._registers.get(4002, b"\0\0\0\0"))
        checks = (
            (listed != self._settings.scan_list, _LIST_INVALID),
            (not 0 < rate * inputs <= _MOST_SAMPLES_PER_S, _RATE_INVALID),
            (size > 32768 or size & (size - 1) or not size, _BUFFER_INVALID),
            (self._number(4016) != 16, _TARGET_INVALID),
        )
        for wrong, detail in checks:
            if wrong:
                raise _Refused(_FAILED, detail)
        self._rate_Hz = rate
        self._stream = _Buffer(size, inputs, self._settings.separator_counts)
        self._clock.restart()

    # --- stream --------------------------------------------------------------------------------------------------

    def sample(self, motion: MotionInterval) -> bytes:
        """Store the scans of an interval of motion; they are sent when they are read."""
        if self._stream is None or not self.line_alive or self._number(4024):  # the trigger never comes
            return b""
        times = self._clock.due(motion, 1.0 / self._rate_Hz) / self._rate_Hz
        if len(times):
            self._stream.put(np.column_stack(self._counts(motion, times)).astype(np.uint16))
        return b""

    def _counts(self, motion: MotionInterval, device_s: Array) -> list[Array]:
        settings = self._settings
        columns = [self._laser(name, each, motion, device_s) for name, each in settings.lasers.items()]
        columns += [self._other(each, len(device_s)) for each in settings.others.values()]
        if settings.tacho is not None:
            columns.append(self._tacho(settings.tacho, motion, device_s))
        return columns

    def _code(self, volts: Array, range_V: float) -> Array:
        return np.clip(np.rint(_ZERO + volts / (_SLOPE_V * range_V / 10.0)), 0, 65534)

    def _laser(self, name: str, laser: AnalogueLaser, motion: MotionInterval, device_s: Array) -> Array:
        reading = self._beams[name].reading(motion, device_s)
        share = np.clip(reading / laser.range_m + 0.5, 0.0, 1.0)
        volts = laser.near_V + share * (laser.far_V - laser.near_V)
        return self._code(np.full_like(volts, _BLOCKED_V) if self._faults["blocked"] else volts, laser.range_V)

    def _other(self, other: AnalogueQuantity, count: int) -> Array:
        return self._code(other.zero_V + _QUIET_V * self._clock.rng.standard_normal(count), other.range_V)

    def _tacho(self, tacho: Tachometer, motion: MotionInterval, device_s: Array) -> Array:
        times = np.clip(self._clock.clock.rig_s(device_s), motion.time_s[0], motion.time_s[-1])
        turned = motion.at(times, 8, 9) - math.radians(tacho.index_angle_deg)
        angle = (turned + 0.5 * _PULSE_RAD) % (2 * math.pi) - 0.5 * _PULSE_RAD  # 0 at the index
        level = np.clip(angle / _FLANK_RAD + 0.5, 0, 1) - np.clip((angle - _PULSE_RAD) / _FLANK_RAD + 0.5, 0, 1)
        if tacho.is_digital:
            high = level > 0.5 if tacho.edge == "rising" else level <= 0.5
            high &= tacho.line not in self._outputs
            return np.where(high, 0xFE00 | 1 << tacho.bit, 0xFE00).astype(np.float64)
        half, swing = tacho.threshold_V, 0.5 * _PULSE_V
        noise = _QUIET_V * self._clock.rng.standard_normal(len(times))
        return self._code(half + swing * (2 * level - 1) * (1 if tacho.edge == "rising" else -1) + noise, tacho.range_V)

    # --- faults --------------------------------------------------------------------------------------------------

    def fail(self, what: str, value: Any = 1) -> None:
        """See FarEnd and `fault_kinds`."""
        if what in self._faults:
            self._faults[what] = bool(value)
        elif what == "other":
            self._serial = int(value)
        elif what == "skips" and self._stream is not None:
            self._stream.skip(int(value))
        elif what == "overlap" and self._stream is not None:
            self._stream.status = 2942
        elif what not in self.fault_kinds:
            super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. After power-up no stream runs."""
        super().power(on, now_s)
        self._pending = b""
        self._start()
        if on:
            self._clock.power_up(now_s)

    def facts(self) -> Mapping[str, Any]:
        """See FarEnd."""
        backlog = len(self._stream.data) if self._stream else 0
        return {"streaming": self._stream is not None, "backlog_bytes": backlog, "outputs": sorted(self._outputs)}
