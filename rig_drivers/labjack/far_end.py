"""A simulated LabJack T7: its registers, its inputs, and a stream in a buffer that overflows.

The pulse of the tachometer is that of a sensor with a finite flank: it rises within some degrees around the index.

Stand-in for a LabJack of a log while the log is played.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.errors import DeviceError, LogError
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World
from rig_drivers.labjack import wire
from rig_drivers.labjack.scans import BLANK_FLASH, CONSTANTS_BYTES, RANGES_V, VoltScale, encode_constants, nominal
from rig_drivers.labjack.settings import AnalogueLaser, AnalogueQuantity, LabJack, Tachometer
from rig_drivers.labjack.wire import BUFFER_BYTES, Register, Status

Array = NDArray[np.floating[Any]]

_SCALE = VoltScale(33530.0, 3.1586e-4, 3.1586e-4)  # not the nominal one at ±10 V, so that it must be read
_FLANK_RAD, _PULSE_RAD = math.radians(4.0), math.radians(30.0)
_PULSE_V = 5.0
_QUIET_V = 2e-4  # noise of inputs that are no lasers
_BLOCKED_V = 10.2
_NO_ADDRESS, _FAILED = 2, 4  # exceptions of Modbus
_LINES = range(Register.DIGITAL_LINE, Register.DIGITAL_LINE + 16)
_WRITABLE = (
    range(Register.STREAM_SCAN_RATE_HZ, Register.STREAM_TRIGGER + 2),
    range(Register.AIN_RANGE, Register.AIN_NEGATIVE + 14),
    (Register.AIN_POWER, Register.FLASH_POINTER),
)
_LIST_INVALID, _RATE_INVALID, _TARGET_INVALID, _BUFFER_INVALID, _BAD_ADDRESS = 2607, 2608, 2612, 2615, 2350
"""Errors of the device that the host does not interpret by name."""
_MOST_SAMPLES_PER_S = 100_000


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
        self.status, self.info = Status.GOOD, 0
        self._size, self._scan_bytes, self._separator_counts = size_bytes, 2 * inputs, separator_counts
        self._skipped = 0

    def put(self, scans: NDArray[np.uint16]) -> None:
        """Store scans. Without room the device skips them until all that wait have been read."""
        if self.status == Status.RECOVERING and not self.data and len(scans):
            stated = self._skipped - (0 if self._separator_counts else 1)
            is_counted = stated < 2**16
            self.status = Status.RECOVERED if is_counted else Status.RECOVERED_TOO_MANY
            self.info = stated if is_counted else 2**16 - 1
            self._skipped = 0
            self.data += b"\xff" * self._scan_bytes
        room = (self._size - len(self.data)) // self._scan_bytes
        if self.status == Status.RECOVERING or room < len(scans):
            kept = 0 if self.status == Status.RECOVERING else room
            self.skip(len(scans) - kept)
            scans = scans[:kept]
        self.data += scans.astype(">u2").tobytes()

    def skip(self, count: int) -> None:
        """Skip scans as a full buffer does."""
        self.status = Status.RECOVERING
        self._skipped += count

    def take(self, samples: int) -> bytes:
        """Return the registers of a stream read."""
        scans = min(2 * samples, len(self.data)) // self._scan_bytes
        data = bytes(self.data[: scans * self._scan_bytes])
        del self.data[: len(data)]
        head = struct.pack(">4H", len(data) // 2, len(self.data), self.status, self.info)
        if self.status in (Status.RECOVERED, Status.RECOVERED_TOO_MANY):
            self.status, self.info = Status.GOOD, 0
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
        self._start()

    def _start(self) -> None:
        self._decoder = wire.MessageDecoder()
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
        out = b""
        for message in self._decoder.feed(data).messages:
            if self._faults["deaf"]:
                continue
            try:
                function, answer = wire.FEEDBACK, self._carry_out(message.body)
            except _Refused as refused:
                self._error = refused.detail
                function, answer = wire.REFUSED, bytes([refused.exception])
            out += wire.encode(wire.Message(message.number, function, answer))
        return out

    def _carry_out(self, body: bytes) -> bytes:
        out = b""
        for register, count, value in wire.parts_of(body):
            if value is None:
                out += self._read(register, count)
            else:
                self._write(register, value)
        return out

    def _read(self, address: int, count: int) -> bytes:
        facts = {
            Register.STREAM_SCAN_RATE_HZ: struct.pack(">f", self._rate_Hz),
            Register.LAST_ERROR: struct.pack(">H", self._error),
            Register.PRODUCT: struct.pack(">f", 7.0),
            Register.FIRMWARE: struct.pack(">f", 1.0299),
            Register.SERIAL: struct.pack(">I", self._serial),
        }
        if address in facts:
            return facts[Register(address)]
        if address == Register.FLASH:
            at = self._number(Register.FLASH_POINTER) - wire.FLASH_CONSTANTS
            if not 0 <= at <= CONSTANTS_BYTES["T7"] - 2 * count:
                raise _Refused(_FAILED, _BAD_ADDRESS)
            return self._flash()[at : at + 2 * count]
        if address == Register.STREAM_DATA:
            if self._stream is None:
                raise _Refused(_FAILED, Status.STREAM_NOT_RUNNING)
            answer = self._stream.take(count - wire.STATE_REGISTERS)
            if self._stream.status == Status.SCAN_OVERLAP:
                self._stream = None
            return answer
        if address not in _LINES:
            raise _Refused(_NO_ADDRESS, 0)
        self._outputs.discard(address - Register.DIGITAL_LINE)
        return b"\0\0"

    def _flash(self) -> bytes:
        if self._faults["blank"]:
            return BLANK_FLASH
        constants = encode_constants("T7", {range_V: _SCALE.of_range(range_V) for range_V in RANGES_V})
        return (2 * constants).ljust(CONSTANTS_BYTES["T7"], b"\0")  # once for each converter

    def _number(self, address: int) -> int:
        return int.from_bytes(self._registers.get(address, b"\0\0\0\0"), "big")

    def _write(self, address: int, data: bytes) -> None:
        if address == Register.STREAM_ENABLE:
            self._enable(any(data))
        elif Register.STREAM_SCAN_RATE_HZ <= address < Register.STREAM_ENABLE and self._stream is not None:
            raise _Refused(_FAILED, Status.STREAM_IS_ACTIVE)
        elif address == Register.STREAM_SCAN_LIST:
            for place in range(0, len(data), 4):
                self._registers[address + place // 2] = data[place : place + 4]
        elif address in _LINES:
            self._outputs.add(address - Register.DIGITAL_LINE)
        elif any(address in each for each in _WRITABLE):
            self._registers[address] = data
        else:
            raise _Refused(_NO_ADDRESS, 0)

    def _enable(self, on: bool) -> None:
        if on == (self._stream is not None):
            raise _Refused(_FAILED, Status.STREAM_IS_ACTIVE if on else Status.STREAM_NOT_RUNNING)
        if not on:
            self._stream = None
            return
        inputs, size = self._number(Register.STREAM_ADDRESSES), self._number(Register.STREAM_BUFFER_BYTES)
        listed = tuple(self._number(Register.STREAM_SCAN_LIST + 2 * place) for place in range(inputs))
        (rate,) = struct.unpack(">f", self._registers.get(Register.STREAM_SCAN_RATE_HZ, b"\0\0\0\0"))
        checks = {
            _LIST_INVALID: listed != self._settings.scan_list,
            _RATE_INVALID: not 0 < rate * inputs <= _MOST_SAMPLES_PER_S,
            _BUFFER_INVALID: size > BUFFER_BYTES or size & (size - 1) or not size,
            _TARGET_INVALID: self._number(Register.STREAM_TARGET) != wire.TARGET_COMMAND,
        }
        if wrong := next((detail for detail, is_wrong in checks.items() if is_wrong), None):
            raise _Refused(_FAILED, wrong)
        self._rate_Hz = rate
        self._stream = _Buffer(size, inputs, self._settings.separator_counts)
        self._clock.restart()

    # --- stream --------------------------------------------------------------------------------------------------

    def sample(self, motion: MotionInterval) -> bytes:
        """Store the scans of an interval of motion; they are sent when they are read."""
        if (
            self._stream is None or not self.line_alive or self._number(Register.STREAM_TRIGGER)
        ):  # the trigger never comes
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
        return np.clip(np.rint(_SCALE.zero + volts / _SCALE.of_range(range_V).above_V), 0, wire.NO_VALUE - 1)

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

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        if what in self._faults:
            self._faults[what] = bool(value)
        elif what == "other":
            self._serial = int(value)
        elif what == "skips" and self._stream is not None:
            self._stream.skip(int(value))
        elif what == "overlap" and self._stream is not None:
            self._stream.status = Status.SCAN_OVERLAP
        elif what not in self.fault_kinds:
            super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. After power-up no stream runs."""
        super().power(on, now_s)
        self._start()
        if on:
            self._clock.power_up(now_s)

    @override
    def facts(self) -> Mapping[str, Any]:
        backlog = len(self._stream.data) if self._stream else 0
        return {"streaming": self._stream is not None, "backlog_bytes": backlog, "outputs": sorted(self._outputs)}


class PlayedLabJack(PlayedDevice):
    """A device that answers the opening dialogue as that of the log did, and then plays its answers at their times.

    Args:
        settings: table of the device in the rig file.
        identity: of the device of the log.

    Raises:
        LogError: the identity is impossible.
    """

    expects = "the command that starts the stream"

    def __init__(self, settings: LabJack, identity: Mapping[str, Any]) -> None:
        super().__init__(sends=False)
        model = identity.get("model", "T7")
        if model not in ("T4", "T7"):
            raise LogError(f"identities.json: expected the model T4 or T7, got {model!r:.40}")
        try:
            scales = {
                name: VoltScale.of(identity, name) or nominal(model, range_V)
                for name, range_V in settings.ranges_V.items()
            }
            answers = {
                Register.PRODUCT: struct.pack(">f", float(model[1:])),
                Register.FIRMWARE: struct.pack(">f", float(identity.get("firmware", 0.0))),
                Register.SERIAL: struct.pack(">I", int(identity.get("device_serial", settings.serial_number))),
                Register.STREAM_SCAN_RATE_HZ: struct.pack(">f", identity.get("scan_rate_Hz", settings.scan_rate_Hz)),
            }
        except (struct.error, TypeError, ValueError, OverflowError, DeviceError) as fault:
            raise LogError(f"identities.json: expected the identity of a LabJack: {fault}") from fault
        of_place = {name if model == "T4" else settings.ranges_V[name]: scale for name, scale in scales.items()}
        blank = str(identity.get("constants", "")).startswith("nominal")
        flash = BLANK_FLASH if blank else encode_constants(model, of_place)
        self._registers: dict[int, bytes] = {**answers, Register.FLASH: flash}

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. Stream reads, and reads of their errors, are not answered: the log has their answers."""
        out = b""
        for message in wire.MessageDecoder().feed(data).messages:
            if message.number >= wire.ERROR_NUMBER:
                continue
            self.commands += 1
            out += wire.encode(wire.Message(message.number, wire.FEEDBACK, self._carry_out(message.body)))
        return out

    def _carry_out(self, body: bytes) -> bytes:
        out = b""
        for register, count, value in wire.parts_of(body):
            if value is None:
                out += self._registers.get(register, b"").ljust(2 * count, b"\0")[: 2 * count]
            elif register == Register.STREAM_ENABLE:
                self._sends = any(value)
        return out
