"""The driver: settings in a rig file, channels, opening dialogue, simulated device, stand-in for replay."""

import queue
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from daq.channels import Channel
from daq.drivers.contract import SampleClock, Talk
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, MotionInterval
from daq.errors import DeviceError
from rig_configs.device import DeviceSettings
from rig_configs.roles import OtherQuantity, Role
from rig_driver_tilt import line
from rig_driver_tilt.pipeline import TiltPipeline

_FIELDS = (("tilt_x_rad", "double"), ("tilt_y_rad", "double"), ("count", "fixed32"), ("device_ms", "fixed64"))
_PERIOD_MS, _ANSWER_S = 10, 1.0


class Tilt(DeviceSettings):
    """The inclinometer's table in a rig file. `height_m`: its height on the column, for the simulation."""

    baud: Annotated[int, Field(ge=9600)] = 115_200
    topic: str = "tilt"
    height_m: Annotated[float, Field(gt=0)] = 0.5
    clock_tolerance_ppm: Annotated[float, Field(gt=0)] = 50.0

    def roles(self, device: str) -> tuple[Role, ...]:
        """Recorded, plotted and exported; no test needs it."""
        return (OtherQuantity(device=device, topic=self.topic, fields=("tilt_x_rad", "tilt_y_rad")),)


class SimulatedTilt(FarEnd):
    """The device at the end of a simulated line."""

    def __init__(self, settings: Tilt, clock: Any) -> None:
        self._height_m, self._clock = settings.height_m, clock
        self._received, self._sends = b"", False
        self._next: int | None = None

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Receive commands; the bytes may be cut anywhere."""
        *commands, self._received = (self._received + data).split(b"\n")
        self._received = self._received[-line.LONGEST :]
        out = b""
        for command in commands:
            if command == b"ID?":
                out += line.encode("I tilt-2 4711")
            elif command in (b"START", b"STOP"):
                self._sends = command == b"START"
        return out

    def sample(self, motion: MotionInterval) -> bytes:
        """Return a line for every ten milliseconds of the device's clock."""
        first, last = (int(float(self._clock.device_s(motion.time_s[i])) * 1000 // _PERIOD_MS) for i in (0, -1))
        numbers = np.arange(first + 1 if self._next is None else self._next, last + 1)
        self._next = max(last + 1, self._next or 0)
        if not self._sends or not len(numbers):
            return b""
        times = np.clip(self._clock.rig_s(numbers * _PERIOD_MS * 1e-3), motion.time_s[0], motion.time_s[-1])
        angles = np.rint([motion.at(times, i, i + 4) / self._height_m / line.RAD for i in (0, 1)]).astype(int)
        rows = zip(numbers.tolist(), *angles.tolist(), strict=True)
        samples = (line.Sample(n % line.COUNT_WRAP, n * _PERIOD_MS % line.MS_WRAP, x, y) for n, x, y in rows)
        return b"".join(map(line.sample_line, samples))


class PlayedTilt(PlayedDevice):
    """The device of a log while it is played: answers with its identity, and is silent until it receives START."""

    expects = "START"

    def __init__(self, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._answer = line.encode(f"I {identity.get('model', 'tilt-2')} {identity.get('serial', '')}")
        self._sends = False

    @property
    def sending(self) -> bool:
        """Whether the device sends."""
        return self._sends

    def begin(self) -> None:
        """Send without START, to a host that sends no commands."""
        self._sends = True

    def hear(self, data: bytes) -> bytes:
        """Receive complete commands."""
        self.commands += data.count(b"\n")
        self._sends = b"START" in data or (self._sends and b"STOP" not in data)
        return self._answer if b"ID?" in data else b""


class TiltDriver(PlainDriver):
    """See daq.drivers.contract.Driver."""

    name, settings = "tilt", Tilt
    claims = frozenset({"checksum", "counts exactly", "falls silent"})

    def channels(self, settings: Tilt) -> tuple[Channel, ...]:
        """Return the channel of the two angles."""
        return (Channel(settings.topic, "rig_driver_tilt.Tilt", _FIELDS),)

    def clocks(self, settings: Tilt) -> tuple[SampleClock, ...]:
        """Return the device's clock, which counts ms."""
        rate, tolerance = 1e3 / _PERIOD_MS, settings.clock_tolerance_ppm
        return (SampleClock(settings.topic, rate, tolerance, "device_ms", 1_000_000, line.COUNT_WRAP),)

    def pipeline(self, device: str, settings: Tilt, identity: Mapping[str, Any]) -> TiltPipeline:
        """Return a new pipeline."""
        return TiltPipeline(device, self.channels(settings)[0], settings.clock_tolerance_ppm)

    def far_end(self, device: str, settings: Tilt, world: Any) -> FarEnd:
        """Return a simulated device."""
        return SimulatedTilt(settings, world.clock(device))

    def played(self, settings: Tilt, identity: Mapping[str, Any]) -> PlayedDevice:
        """Return the stand-in for the device of a log."""
        return PlayedTilt(identity)

    def open(self, device: str, settings: Tilt, talk: Talk) -> dict[str, Any]:
        """Query the identity, drop the rest of an earlier stream, start."""
        talk.send(b"STOP\nID?\n")
        try:
            _, model, serial = talk.replies.get(timeout=_ANSWER_S).split(" ")
        except (queue.Empty, ValueError) as error:
            raise DeviceError(
                f"{device} on {settings.port}: no answer to ID?. Is it powered, its line at {settings.baud} baud?"
            ) from error
        talk.restart_decoding()
        talk.send(b"START\n")
        return {"model": model, "serial": serial}

    def stop(self, talk: Talk) -> None:
        """End the stream."""
        talk.send(b"STOP\n")


DRIVER = TiltDriver()
