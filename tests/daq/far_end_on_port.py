"""A simulated device on a port with a line rate, on simulated time: what `daq.discovery` opens, reads and writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daq.drivers.contract import DeviceLine
from daq.drivers.driver import Driver
from daq.drivers.registry import driver
from daq.drivers.simulated import FarEnd
from daq.transports.host_clock import HostClock
from daq.transports.slcan import AdapterText
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_configs import load_rig
from rig_configs.schema import Radio, SimulatedSensors, Virtual

START_NS = 1_700_000_000_000_000_000
PORT = "/dev/ttyUSB7"


class HandClock(HostClock):
    """A clock that passes only when a port is read."""

    def __init__(self) -> None:
        super().__init__()
        self.now: float = 0.0

    def now_ns(self) -> int:
        return START_NS + round(self.now * 1e9)


class SilentDevice(FarEnd):
    """No device: it sends and answers nothing."""


@dataclass
class Source(FarEnd):
    """A device of an unknown kind, which sends bytes of a function of the time step."""

    make: Callable[[], bytes]
    line_alive: bool = True

    def step(self, now_s: float) -> bytes:
        return self.make()


class Cable:
    """A port, and the device on it.

    Attributes:
        far: the device.
        lines: lines with which the port was opened.
        written: bytes that were sent to the device, in any line's settings.
    """

    def __init__(self, far: Callable[[World], FarEnd], line: DeviceLine | None = None, port: str = PORT) -> None:
        sensors = SimulatedSensors(laser_noise_m=4e-6, draw_calibration=False)
        virtual = Virtual(seed=4, sensors=sensors, radio=Radio(burst_start=0.0))
        self.motion = SimulatedMotion(load_rig("virtual").true_physics, virtual.drive.slip, virtual.drive.lag_s)
        self.far = far(World(virtual, self.motion))
        self.clock = HandClock()
        self.port, self.line = port, line
        bus = line is not None and line.bitrate is not None and not port.startswith("can:")
        self.text: AdapterText | None = AdapterText() if bus else None
        self.lines: list[DeviceLine] = []
        self.written: list[bytes] = []
        self.rng = np.random.default_rng(3)

    @classmethod
    def of(cls, name: str, port: str = PORT, **settings: Any) -> Cable:
        """The simulated device of a driver with these settings, on a port with its line's rate."""
        found: Driver = driver(name)
        table = found.example_at(port, **settings)
        return cls(lambda world: found.far_end("device", table, world), found.line(table), port)

    def connect(self, line: DeviceLine) -> CableLink:
        self.lines.append(line)
        fits = self.line is None or (line.baud, line.parity) == (self.line.baud, self.line.parity)
        return CableLink(self, fits or not self.port.startswith("/dev/tty"))

    def advance(self, seconds: float) -> bytes:
        self.clock.now += seconds
        out = self.far.step(self.motion.time_s)
        stretch = self.motion.advance(self.clock.now)
        return out if stretch is None else out + self.far.sample(stretch)


@dataclass
class CableLink:
    """The open port; at another line's settings than the device's, bytes of both directions are damaged."""

    cable: Cable
    fits: bool
    waiting: bytes = b""
    name: str = "cable"
    closed: bool = field(default=False)

    def read(self, timeout_s: float) -> bytes:
        data, self.waiting = self.waiting + self._text_of(self.cable.advance(timeout_s)), b""
        return data if self.fits else self.cable.rng.bytes(len(data))

    def write(self, data: bytes) -> None:
        self.cable.written.append(data)
        heard = data if self.fits else self.cable.rng.bytes(len(data))
        if self.cable.text is not None:
            heard, answers = self.cable.text.received(heard)
            self.waiting += answers
        self.waiting += self._text_of(self.cable.far.receive(heard, self.cable.motion.time_s))

    def _text_of(self, data: bytes) -> bytes:
        return data if self.cable.text is None else self.cable.text.sent(data)

    def close(self) -> None:
        assert not self.closed
        self.closed = True
