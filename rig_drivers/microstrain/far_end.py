"""A simulated node on the rotor behind its base station: answers commands, samples at the beacon's time.

Its packets are built from the maker's layouts, independent of the decoder.

Stand-in for a MicroStrain node and its base station of a log while the log is played.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink.far_end import Air
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.errors import LogError
from daq.virtual_rig.world import DeviceClock, World
from rig_configs.schema import Radio
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.rates import RATES_HZ
from rig_drivers.microstrain.settings import MicroStrainNode

_BASE = 0x1234
_SWEEPS = 8  # of a packet
_REPEATED_EACH = 32  # packets, of which one is received twice
_IDLE_AFTER_S = 0.2
_NODE_RSSI_DBM, _BASE_RSSI_DBM = -49, -61
_UINT16, _FLOAT = 7, 2
_SYNC_MODE = 2
_FOREIGN = 0x4321
_MODEL, _MODEL_OPTION, _NODE_SERIAL, _BASE_SERIAL, _FIRMWARE = 6305, 1000, 48_211, 7_314, 0x0C05


@dataclass(frozen=True)
class AngleSensors:
    """The sensors of both pendulums.

    Attributes:
        zero_rad: zero error of each sensor, rad, shape (2,).
        noise_rad: standard deviation of the noise before quantisation, rad.
        rng: source of the noise.
    """

    zero_rad: NDArray[np.floating]
    noise_rad: float
    rng: np.random.Generator


class SimulatedMicroStrain(FarEnd):
    """Base station, radio and node.

    Attributes:
        air: the radio.
        streaming: whether the node samples and the beacon is on.
        data_type: data type of the values: 7 for words of 16 bits, 2 for floating-point numbers.
        eeprom: words of the node's EEPROM, by place.

    Args:
        config: table of the node in the rig file.
        sensors: the angle sensors.
        clock: clock of the base station.
        air: the radio.
        words: words of the node's EEPROM that identify it.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "radio": FaultKind("all packets on air are lost in both directions; the base station answers"),
        "dead": FaultKind("the node sends nothing any more"),
        "foreign": FaultKind("packets of another node come", 10, end=None, meaning="how many", limits=(0, 1000)),
        "repeats": FaultKind("every packet is received twice"),
        "open sensor": FaultKind("the sensor of pendulum A is disconnected: its values are not numbers"),
        "beacon": FaultKind("the base station loses its beacon", end=None),
        "deaf": FaultKind("the base station answers no request"),
        "serial": FaultKind("it is another node", 1, end=None, meaning="number of the node", limits=(0, 65535)),
        "rate": FaultKind("the node is set to another rate", 106, end=None, meaning="code", limits=(0, 255)),
    }

    def __init__(
        self, config: MicroStrainNode, sensors: AngleSensors, clock: DeviceClock, air: Air, words: Mapping[int, int]
    ) -> None:
        self._config, self._sensors, self._clock = config, sensors, clock
        self.air: Air = air
        codes = 2 * math.pi / abs(config.slope_a_rad)
        self.data_type: int = _UINT16 if 256 <= codes <= 65536 and config.slope_a_rad == config.slope_b_rad else _FLOAT
        self._code = next(code for code, rate in RATES_HZ.items() if rate == config.rate_Hz)
        mask = sum(1 << (number - 1) for number in set(config.used_channels))
        self.eeprom: dict[int, int] = {**words, 12: mask, 72: self._code}
        self._base_eeprom = _identity_words(_BASE_SERIAL)
        self._request = bytearray()
        self._utc_s: int | None = None  # time to which the beacon was set; None: it is off
        self._started = False
        self._idle_due_s: float | None = None
        self._dead = self._deaf = self._repeats = self._open = self._without_supply = False
        self._waiting: list[bytes] = []  # on their way to the host
        self._landed = 0
        self._begin()

    def _begin(self) -> None:
        """Begin to sample with tick 0."""
        self._next: int | None = None
        self._first = 0
        self._pending: list[NDArray[np.float64]] = []

    @classmethod
    def of(cls, device: str, config: MicroStrainNode, world: World) -> Self:
        """Make the node of a simulated rig."""
        zero = world.spread * math.radians(config.zero_std_deg) * world.calibration.standard_normal(2)
        noise_rad = world.virtual.sensors.encoder_noise_counts * 2 * math.pi / config.counts_per_revolution
        sensors = AngleSensors(zero, noise_rad, world.rng(f"noise {device}"))
        air = Air(world.virtual.radio, world.rng(f"radio {device}"))
        return cls(config, sensors, world.clock(device), air, _identity_words(_NODE_SERIAL))

    @classmethod
    def unmoved(cls, config: MicroStrainNode, model: int, option: int, number: int) -> Self:
        """Make a base station and a node that only answer requests.

        Args:
            config: table of the node in the rig file.
            model, option, number: parts of the node's serial number.
        """
        rng = np.random.default_rng(0)
        sensors = AngleSensors(np.zeros(2), 0.0, rng)
        words = {**_identity_words(number), 46: model, 48: option}
        return cls(config, sensors, DeviceClock(0.0, 0.0), Air(Radio(burst_start=0.0), rng), words)

    def start(self) -> None:
        """Sample and send the beacon without a command."""
        self._started, self._utc_s = True, 0

    @property
    def streaming(self) -> bool:
        """See above."""
        return self._started and self._utc_s is not None

    # --- commands ------------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take request bytes, split at any place; return the answers."""
        self._request += data
        start, head, tail = (0xAA, 6, 2) if self._config.aspp == 1 else (0xAC, 9, 6)
        out = b""
        while (at := self._request.find(start)) >= 0:
            del self._request[:at]
            if len(self._request) < head:
                return out
            size = head + (self._request[5] if self._config.aspp == 1 else self._request[8]) + tail
            if len(self._request) < size:
                return out
            frame = bytes(self._request[:size])
            if not self._is_intact(frame):
                del self._request[:1]
                continue
            del self._request[:size]
            address = int.from_bytes(frame[3 : 5 if self._config.aspp == 1 else 7], "big")
            payload = frame[head:-tail]
            if len(payload) >= 2 and not self._deaf:
                out += self._execute(address, struct.unpack_from(">H", payload)[0], payload[2:], now_s)
        self._request.clear()
        return out

    def _is_intact(self, frame: bytes) -> bool:
        if self._config.aspp == 1:
            return sum(frame[1:-2]) == int.from_bytes(frame[-2:], "big")
        return zlib.crc32(frame[:-4]) == int.from_bytes(frame[-4:], "big")

    def _execute(self, address: int, command: int, data: bytes, now_s: float) -> bytes:
        if address == _BASE:
            return self._base_execute(command, data, now_s)
        if address == self._config.node_address and self._hears():
            return self._node_execute(command, data)
        return b""

    def _base_execute(self, command: int, data: bytes, now_s: float) -> bytes:
        head = struct.pack(">H", command) + data
        match command:
            case 0x0001:
                return self._frame(0x31, _BASE, head)
            case 0x0073:
                return self._word(_BASE, head, self._base_eeprom)
            case 0x0091:
                self._idle_due_s = now_s + _IDLE_AFTER_S
                return self._frame(0x34, _BASE, head[:2] + b"\0" + bytes.fromhex("7F800000") + data)
            case 0xBEAC:
                seconds = int.from_bytes(data, "big")
                self._utc_s = None if seconds == 0xFFFFFFFF else seconds
                self._clock.reset(now_s)
                self._begin()
                return self._frame(0x31, _BASE, head)
            case 0xBEAD:
                return self._frame(0x31, _BASE, head + self._beacon(now_s))
            case _:
                return b""

    def _hears(self) -> bool:
        """Whether the node receives a command: not while it samples."""
        return not (self.streaming or self._dead or self._without_supply or self.air.silent)

    def _node_execute(self, command: int, data: bytes) -> bytes:
        head = struct.pack(">H", command) + data
        if command == 0x0007:
            return self._word(self._config.node_address, head, self.eeprom)
        if command == 0x003B:
            self._started = True
            self._begin()
            return self._frame(0x00 if self._config.aspp == 1 else 0x22, self._config.node_address, head + b"\0")
        return b""

    def _word(self, address: int, head: bytes, words: Mapping[int, int]) -> bytes:
        """Return the answer to a query of the EEPROM: its word, or code 1."""
        word, base = words.get(int.from_bytes(head[2:4], "big")), address == _BASE
        if word is None:
            return self._frame(0x32 if base else 0x02, address, head + b"\x01")
        kind = 0x31 if base else 0x00 if self._config.aspp == 1 else 0x22
        return self._frame(kind, address, head + struct.pack(">H", word))

    def _beacon(self, now_s: float) -> bytes:
        """Return state and time of the beacon."""
        if self._utc_s is None:
            return bytes(9)
        passed_ns = round(float(self._clock.device_s(now_s)) * 1e9)
        return struct.pack(">BII", 1, self._utc_s + passed_ns // 10**9, passed_ns % 10**9)

    def _frame(self, kind: int, address: int, payload: bytes) -> bytes:
        """Return a packet to the host."""
        signals = struct.pack(">bb", _NODE_RSSI_DBM, _BASE_RSSI_DBM)
        if self._config.aspp == 1:
            body = struct.pack(">BBHB", 0x07, kind, address, len(payload)) + payload
            return b"\xaa" + body + signals + struct.pack(">H", sum(body) & 0xFFFF)
        body = struct.pack(">BBBIH", 0xAC, 0x08, kind, address, len(payload)) + payload + signals
        return body + struct.pack(">I", zlib.crc32(body))

    # --- sampling ------------------------------------------------------------------------------------------------

    def step(self, now_s: float) -> bytes:
        """See FarEnd: a node that was commanded to be idle stops a little later."""
        if self._idle_due_s is None or now_s < self._idle_due_s or self._deaf:
            return b""
        if self._dead or self._without_supply or self.air.silent:
            return b""  # the base station continues to command it
        self._idle_due_s, self._started = None, False
        self.air.lose_flying()
        node = self._config.node_address
        argument = struct.pack(">H" if self._config.aspp == 1 else ">I", node)
        return self._frame(0x31, _BASE, b"\x00\x91" + argument + b"\0")

    @override
    def sample(self, motion: MotionInterval) -> bytes:
        if self.streaming and not self._without_supply:
            self._sweep(motion)
        for _, packet in self.air.landed(float(motion.time_s[-1])):
            self._landed += 1
            self._waiting += [packet] * (2 if self._repeats or self._landed % _REPEATED_EACH == 0 else 1)
        out, self._waiting = b"".join(self._waiting), []
        return out

    def _sweep(self, motion: MotionInterval) -> None:
        """Take the sweeps of an interval, and send the packets that are full."""
        rate = self._config.rate_Hz
        last = math.floor(float(self._clock.device_s(motion.time_s[-1])) * rate)
        if self._next is None:
            self._next = self._first = math.floor(float(self._clock.device_s(motion.time_s[0])) * rate) + 1
        numbers = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        if not len(numbers):
            return
        times = np.clip(self._clock.rig_s(numbers / rate), motion.time_s[0], motion.time_s[-1])
        angles = np.column_stack([motion.at(times, 2, 6), motion.at(times, 3, 7)]) + self._sensors.zero_rad
        angles += self._sensors.noise_rad * self._sensors.rng.standard_normal(angles.shape)
        for number, time_s, row in zip(numbers.tolist(), times.tolist(), self._outputs(angles), strict=True):
            self._pending.append(row)
            if len(self._pending) == _SWEEPS:
                self._send(number - _SWEEPS + 1, time_s)

    def _outputs(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values of the active channels, ascending, shape (n, channels)."""
        config = self._config
        active = sorted(set(config.used_channels))
        out = np.tile(100.0 * np.array(active), (len(angles), 1))
        slopes = (config.slope_a_rad, config.slope_b_rad)
        for k, (channel, slope, offset) in enumerate(
            zip(config.used_channels[:2], slopes, (config.offset_a_rad, config.offset_b_rad), strict=True)
        ):
            angle = angles[:, k] - offset
            if config.turns:
                angle = np.mod(angle * math.copysign(1.0, slope), 2 * math.pi) * math.copysign(1.0, slope)
            out[:, active.index(channel)] = angle / slope
        if self._open:
            out[:, active.index(config.channel_a)] = np.nan
        return out

    def _send(self, number: int, time_s: float) -> None:
        """Send the pending sweeps, of which the first has a number on the beacon's grid."""
        assert self._utc_s is not None
        rows, self._pending = np.array(self._pending), []
        float_rows = self.data_type == _FLOAT or self._open
        kind = _FLOAT if float_rows else _UINT16
        words = np.rint(rows) % 65536 if self._config.turns else np.clip(np.rint(rows), 0, 65535)
        data = rows.astype(">f4").tobytes() if float_rows else words.astype(">u2").tobytes()
        tick = (number - self._first) % 65536
        after_ns = round(number * 1e9 / self._config.rate_Hz)
        if self._config.aspp == 1:
            when = struct.pack(">II", self._utc_s + after_ns // 10**9, after_ns % 10**9)
            head = struct.pack(">HBBH", self.eeprom[12], self._code, _SYNC_MODE << 4 | kind, tick) + when
        else:
            when = struct.pack(">Q", self._utc_s * 10**9 + after_ns)
            head = bytes(4) + struct.pack(">HBBH", self.eeprom[12], self._code, kind, tick) + when
        if not self._dead:
            self.air.uplink(time_s, self._frame(0x1A, self._config.node_address, head + data))

    # --- faults --------------------------------------------------------------------------------------------------

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        match what:
            case "radio":
                self.air.silent = bool(value)
            case "dead":
                self._dead = bool(value)
            case "foreign":
                self._waiting += [self._frame(0x1A, _FOREIGN, bytes(20))] * int(value)
            case "repeats":
                self._repeats = bool(value)
            case "open sensor":
                self._open = bool(value)
            case "beacon":
                self._utc_s = None
            case "deaf":
                self._deaf = bool(value)
            case "serial":
                self.eeprom.update(_identity_words(int(value)))
            case "rate":
                self.eeprom[72] = int(value)
            case _:
                super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The supply is the node's battery; its default mode is synchronized sampling."""
        self._without_supply = not on
        if on:
            self._begin()
            self._waiting.append(self._frame(0x18, self._config.node_address, bytes(8)))


def _identity_words(serial: int) -> dict[int, int]:
    """Return the words of an EEPROM that identify a device."""
    return {46: _MODEL, 48: _MODEL_OPTION, 20: serial >> 16, 22: serial & 0xFFFF, 108: _FIRMWARE, 110: 0}


class PlayedMicroStrain(PlayedDevice):
    """A base station and a node that answer as those of the log.

    Queries of the beacon's time are not answered: the log contains the answers that belong to its samples.

    Args:
        identity: identity of the node from its opening. Missing entries are taken from the rig file.
        settings: table of the node in the rig file.

    Raises:
        LogError: the identity is impossible for such a node.
    """

    expects = "the start of synchronized sampling"

    def __init__(self, settings: MicroStrainNode, identity: Mapping[str, Any]) -> None:
        super().__init__()
        serial = str(identity.get("serial") or settings.serial or "0-0-0")
        try:
            model, option, number = (int(part) for part in serial.split("-"))
        except ValueError as error:
            raise LogError(f"identities.json: expected a serial like 6305-1000-12345, got {serial!r:.80}") from error
        if not (0 <= model < 2**16 and 0 <= option < 2**16 and 0 <= number < 2**32):
            raise LogError(f"identities.json: the serial {serial!r:.80} is impossible for a node")
        self._node = SimulatedMicroStrain.unmoved(settings, model, option, number)
        self._status = wire.request(settings.aspp, wire.BASE_ADDRESS, wire.BEACON_STATUS)

    @property
    @override
    def sending(self) -> bool:
        return self._node.streaming

    @override
    def begin(self) -> None:
        self._node.start()

    @override
    def hear(self, data: bytes) -> bytes:
        self.commands += 1
        return self._node.receive(data.replace(self._status, b""), 0.0) + self._node.step(1.0)
