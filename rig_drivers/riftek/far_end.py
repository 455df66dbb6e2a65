"""A simulated RF60x sensor: answers requests, streams results on its own clock.

Stand-in for an RF60x sensor of a log while the log is played.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.errors import LogError
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World
from rig_drivers.riftek import wire
from rig_drivers.riftek.settings import RiftekLaser

_NO_TARGET = 0
_KIND, _FIRMWARE, _BASE_MM = 63, 0x40, 80
_MESSAGE_BYTES = {wire.READ: 2, wire.WRITE: 4, wire.STORE: 2}
_WORDS = {wire.PERIOD: wire.PERIODS_US, wire.INTEGRATION: wire.INTEGRATIONS_US, wire.ZERO: wire.ZEROS}
_FACTORY = {
    wire.POWER: 1,
    wire.CONTROL: 0x02,
    wire.AVERAGES: 1,
    wire.PERIOD: 0x88,
    wire.PERIOD + 1: 0x13,
    wire.INTEGRATION: 0x80,
    wire.INTEGRATION + 1: 0x0C,
    wire.ZERO: 0,
    wire.ZERO + 1: 0,
}


class SimulatedRiftek(FarEnd):
    """One sensor on its serial line.

    Attributes:
        streaming: whether the sensor was commanded to send results.
        parameters: values of the parameters, one byte each, by number.
        fault_code: result that the sensor sends in place of the measured one; None without a fault.

    Args:
        config: table of the sensor in the rig file.
        beam: its beam.
        serial: serial number, a decimal number below 65536.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every result is 0"),
        "code": FaultKind("every result is the same", _NO_TARGET, end=-1, meaning="the result", limits=(-1, 16384)),
        "lost": FaultKind("results get lost on the line", 100, end=None, meaning="how many", limits=(0, 1e6)),
        "stale": FaultKind("its results are not new ones"),
        "deaf": FaultKind("it ignores every request"),
        "range": FaultKind("it is another sensor", 10, end=None, meaning="its range, mm", limits=(1, 2500)),
    }

    def __init__(
        self,
        config: RiftekLaser,
        beam: Beam,
        serial: str,
    ) -> None:
        self._config, self._beam = config, beam
        self.streaming: bool = False
        self.parameters: dict[int, int] = dict(_FACTORY)
        self._stored = dict(_FACTORY)
        self.fault_code: int | None = None
        self._deaf = self._stale = False
        self._lose = 0
        self._range_mm = round(config.range_m * 1e3)
        self._serial = int(serial) & 0xFFFF
        self._number = int(beam.rng.integers(0, wire.NUMBERS))  # number of the next packet
        self._request = bytearray()

    @property
    def period_us(self) -> int:
        """Sampling period that was set, µs."""
        return self._word(wire.PERIOD)

    def _word(self, parameter: int) -> int:
        return self.parameters[parameter] | self.parameters[parameter + 1] << 8

    @classmethod
    def of(cls, device: str, config: RiftekLaser, world: World) -> SimulatedRiftek:
        """Make the sensor of a simulated rig."""
        return cls(config, Beam.of(device, config, world), f"19{world.number(device, config.topic):03d}")

    @classmethod
    def unmoved(cls, config: RiftekLaser, serial: str) -> SimulatedRiftek:
        """Make a sensor that only answers requests."""
        return cls(config, Beam.unmoved(), serial)

    def receive(self, data: bytes, now_s: float = 0.0) -> bytes:
        """Take request bytes, split at any place; return the answers."""
        out = b""
        for byte in data:
            if byte < 0x80:
                self._request = bytearray([byte])
            elif self._request:
                self._request.append(byte)
                code = self._request[1] & 0x0F
                if len(self._request) == 2 + _MESSAGE_BYTES.get(code, 0):
                    out += self._execute(self._request[0], code, bytes(self._request[2:]))
                    self._request.clear()
        return out

    def _execute(self, address: int, code: int, halves: bytes) -> bytes:
        if self._deaf or address not in (self._config.address, wire.EVERYONE):
            return b""
        message = bytes(low & 0x0F | (high & 0x0F) << 4 for low, high in zip(halves[::2], halves[1::2], strict=True))
        match code:
            case wire.IDENTIFY:
                words = (self._serial, _BASE_MM, self._range_mm)
                data = bytes([_KIND, _FIRMWARE]) + b"".join(word.to_bytes(2, "little") for word in words)
                return self._answer(data)
            case wire.READ:
                return self._answer(bytes([self.parameters.get(message[0], 0)]))
            case wire.WRITE:
                self._write(message[0], message[1])
            case wire.STORE:
                self._stored = dict(self.parameters)
                return self._answer(message)
            case wire.START:
                self.streaming = True
                self._beam.restart()
            case wire.STOP:
                self.streaming = False
            case _:
                pass
        return b""

    def _answer(self, data: bytes) -> bytes:
        self._number += 1
        return wire.packet(data, self._number - 1)

    def _write(self, parameter: int, value: int) -> None:
        """Set a parameter, unless its word would then be out of bounds."""
        before = self.parameters.get(parameter, 0)
        self.parameters[parameter] = value
        word = parameter if parameter in _WORDS else parameter - 1
        if word in _WORDS and not _WORDS[word][0] <= self._word(word) <= _WORDS[word][1]:
            self.parameters[parameter] = before
        if word == wire.PERIOD:
            self._beam.restart()

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the bytes of the samples in an interval of motion."""
        period = 1e-6 * self.period_us
        numbers = self._beam.due(motion, period)
        if not len(numbers):
            return b""
        reading = self._beam.reading(motion, numbers * period)
        if not self.streaming:
            return b""
        packets = self._number + np.arange(len(numbers))
        self._number += len(numbers)
        lost = min(self._lose, len(numbers))
        self._lose -= lost
        return wire.results(self._codes(reading)[lost:], packets[lost:], updated=not self._stale)

    def _codes(self, reading: NDArray[np.floating]) -> NDArray[np.int64]:
        half = 0.5 * self._config.range_m
        codes = wire.code(np.clip(reading, -half, half) + half, self._config.range_m)
        codes[np.abs(reading) > half] = _NO_TARGET
        if self.fault_code is not None:
            codes[:] = self.fault_code
        return codes

    def fail(self, what: str, value: Any = 1) -> None:
        """See FarEnd and `fault_kinds`; a code below 0 ends the fault "code"."""
        match what:
            case "blocked":
                self.fault_code = _NO_TARGET if value else None
            case "code":
                self.fault_code = int(value) if value >= 0 else None
            case "lost":
                self._lose = int(value)
            case "stale":
                self._stale = bool(value)
            case "deaf":
                self._deaf = bool(value)
            case "range":
                self._range_mm = int(value)
            case _:
                super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. After power-up the sensor has its stored parameters, does not stream, and counts from 0."""
        super().power(on, now_s)
        if on:
            self._beam.clock.reset(now_s)
            self.streaming, self._next, self._number = False, None, 0
            self.parameters = dict(self._stored)
            self._request.clear()


class PlayedRiftek(PlayedDevice):
    """An RF60x sensor that answers as the sensor of the log. Commands do not change the bytes of the log.

    Args:
        identity: identity of the sensor from its opening. Missing entries are taken from the rig file.
        settings: table of the sensor in the rig file.

    Raises:
        LogError: the identity is impossible for such a sensor.
    """

    expects = "the start of the stream"

    def __init__(self, settings: RiftekLaser, identity: Mapping[str, Any]) -> None:
        super().__init__()
        range_m = identity.get("told_range_m", identity.get("range_m", settings.range_m))
        serial = str(identity.get("serial", "0"))
        if not isinstance(range_m, int | float) or not 0 < range_m < 65.536 or not serial.isdecimal():
            raise LogError(f"identities.json: expected range and serial number of an RF60x, got {dict(identity)!r:.80}")
        reported = settings.model_copy(update={"range_m": float(range_m)})
        self._sensor = SimulatedRiftek.unmoved(reported, serial)

    @property
    @override
    def sending(self) -> bool:
        return self._sensor.streaming

    @override
    def begin(self) -> None:
        self._sensor.streaming = True

    @override
    def hear(self, data: bytes) -> bytes:
        self.commands += sum(byte < 0x80 for byte in data)
        return self._sensor.receive(data)
