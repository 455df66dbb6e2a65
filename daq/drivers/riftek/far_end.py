# pyright: strict
"""A simulated RF60x sensor: answers requests, streams results on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from daq.drivers.riftek import wire
from daq.drivers.riftek.settings import RiftekLaser
from daq.drivers.simulated import FarEnd, FaultKind, Stretch
from daq.virtual_rig.world import DeviceClock, World

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
        streaming: whether it was told to send results.
        parameters: by number, bytes.
        fault_code: a result it gives in place of what it sees; None when it is sound.

    Args:
        config: its table of the rig file.
        look: shape (2,), what it sees of x and y (axis angle and gain in it), dimensionless.
        offset_m: reading at rest against mid-range.
        noise_m: standard deviation of one sample.
        serial: a number below 65536.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("something stands in the beam: every result is 0"),
        "code": FaultKind("every result is the same", _NO_TARGET, end=-1, meaning="the result", limits=(-1, 16384)),
        "lost": FaultKind("results get lost on the line", 100, end=None, meaning="how many", limits=(0, 1e6)),
        "stale": FaultKind("its results are no new ones"),
        "deaf": FaultKind("it heeds no request"),
        "range": FaultKind("it is another sensor", 10, end=None, meaning="its range, mm", limits=(1, 2500)),
    }

    def __init__(
        self,
        config: RiftekLaser,
        look: NDArray[np.floating],
        offset_m: float,
        noise_m: float,
        clock: DeviceClock,
        rng: np.random.Generator,
        serial: str,
    ) -> None:
        self._config, self._look, self._offset, self._noise = config, look, offset_m, noise_m
        self._clock, self._rng = clock, rng
        self.streaming = False
        self.parameters, self._stored = dict(_FACTORY), dict(_FACTORY)
        self.fault_code: int | None = None
        self._deaf = self._stale = False
        self._lose = 0
        self._range_mm = round(config.range_m * 1e3)
        self._serial = int(serial) & 0xFFFF
        self._number = int(rng.integers(0, wire.NUMBERS))  # of the next packet
        self._request = bytearray()
        self._next: int | None = None  # number of the next sample on the sensor's clock; None before the first

    @property
    def period_us(self) -> int:
        """The sampling period it was given."""
        return self._word(wire.PERIOD)

    def _word(self, parameter: int) -> int:
        return self.parameters[parameter] | self.parameters[parameter + 1] << 8

    @classmethod
    def of(cls, device: str, config: RiftekLaser, world: World) -> SimulatedRiftek:
        """The sensor of a simulated rig."""
        gain = config.lever_ratio * (1 + world.spread * config.gain_std * world.calibration.standard_normal())
        look = gain * world.direction(config.axis, config.direction_deg)
        return cls(
            config,
            look,
            5e-5 * world.calibration.standard_normal(),
            world.virtual.sensors.laser_noise_m,
            world.clock(device),
            world.rng(f"noise {device}"),
            serial=f"19{world.number(device, config.topic):03d}",
        )

    @classmethod
    def unmoved(cls, config: RiftekLaser, serial: str) -> SimulatedRiftek:
        """A sensor that only answers."""
        return cls(config, np.zeros(2), 0.0, 0.0, DeviceClock(0.0, 0.0), np.random.default_rng(0), serial)

    def receive(self, data: bytes, now_s: float = 0.0) -> bytes:
        """Take request bytes, cut anywhere; returns the answers."""
        out = b""
        for byte in data:
            if byte < 0x80:
                self._request = bytearray([byte])
            elif self._request:
                self._request.append(byte)
                code = self._request[1] & 0x0F
                if len(self._request) == 2 + _MESSAGE_BYTES.get(code, 0):
                    out += self._heed(self._request[0], code, bytes(self._request[2:]))
                    self._request.clear()
        return out

    def _heed(self, address: int, code: int, halves: bytes) -> bytes:
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
                self.streaming, self._next = True, None
            case wire.STOP:
                self.streaming = False
            case _:
                pass
        return b""

    def _answer(self, data: bytes) -> bytes:
        self._number += 1
        return wire.packet(data, self._number - 1)

    def _write(self, parameter: int, value: int) -> None:
        """Take a value, unless its word would be out of bounds by it."""
        before = self.parameters.get(parameter, 0)
        self.parameters[parameter] = value
        word = parameter if parameter in _WORDS else parameter - 1
        if word in _WORDS and not _WORDS[word][0] <= self._word(word) <= _WORDS[word][1]:
            self.parameters[parameter] = before
        if word == wire.PERIOD:
            self._next = None

    def sample(self, motion: Stretch) -> bytes:
        """The stream's bytes for the samples that fall into a stretch of motion."""
        period = 1e-6 * self.period_us
        last = int(np.floor(float(self._clock.device_s(float(motion.time_s[-1]))) / period))
        if self._next is None:  # begin to count now
            self._next = int(np.floor(float(self._clock.device_s(float(motion.time_s[0]))) / period)) + 1
        numbers = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        if not len(numbers):
            return b""
        times = np.clip(self._clock.rig_s(numbers * period), motion.time_s[0], motion.time_s[-1])
        seen = self._look[0] * motion.at(times, 0, 4) + self._look[1] * motion.at(times, 1, 5)
        seen = seen + self._offset + self._noise * self._rng.standard_normal(len(numbers))
        if not self.streaming:
            return b""
        packets = self._number + np.arange(len(numbers))
        self._number += len(numbers)
        lost = min(self._lose, len(numbers))
        self._lose -= lost
        return wire.results(self._codes(seen)[lost:], packets[lost:], updated=not self._stale)

    def _codes(self, seen: NDArray[np.floating]) -> NDArray[np.int64]:
        half = 0.5 * self._config.range_m
        codes = wire.code(np.clip(seen, -half, half) + half, self._config.range_m)
        codes[np.abs(seen) > half] = _NO_TARGET
        if self.fault_code is not None:
            codes[:] = self.fault_code
        return codes

    def fail(self, what: str, value: Any = 1) -> None:
        """See FarEnd and `fault_kinds`; a code below 0 ends it."""
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
        """See FarEnd: it has its stored parameters, sends nothing yet, and counts from 0."""
        super().power(on, now_s)
        if on:
            self._clock.begin_anew(now_s)
            self.streaming, self._next, self._number = False, None, 0
            self.parameters = dict(self._stored)
            self._request.clear()
