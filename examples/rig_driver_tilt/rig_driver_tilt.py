"""A two-axis inclinometer on a serial line, as a driver.

The device is silent until it receives START. Then it sends a line a sample, with a counter that wraps after 999, its
own time in ms, two angles in units of 1e-6 rad, and a CRC-16 of the characters before the asterisk:

    T 017 0000001700 -123 45*8F3A

It answers ID? with `I tilt-2 SERIAL`, and takes STOP.
"""

import binascii
import re
from functools import partial
from typing import Annotated, Any

from pydantic import Field

from daq.channels import Channel
from daq.drivers.contract import Talk
from daq.drivers.driver import Driver
from daq.drivers.line_sensor import Commands, LinePipeline, PlayedSensor, Reading, SimulatedSensor, asked, line_clock
from daq.numbered.messages import Count
from rig_configs.device import DeviceSettings
from rig_configs.roles import OtherQuantity, Role

PERIOD_MS, UNIT_RAD = 10, 1e-6
COUNT = Count(1000, PERIOD_MS * 1e6, clock_size=2**32, clock_step=PERIOD_MS)
FIELDS = (("tilt_x_rad", "double"), ("tilt_y_rad", "double"), ("count", "fixed32"), ("device_ms", "fixed64"))
SAMPLE, ANSWER = re.compile(rb"T (\d{3}) (\d{10}) (-?\d{1,9}) (-?\d{1,9})"), re.compile(rb"I \S+ \S+")


class Tilt(DeviceSettings):
    """The inclinometer's table in a rig file. `height_m`: its height on the column, for the simulation."""

    baud: Annotated[int, Field(ge=9600)] = 115_200
    topic: str = "tilt"
    height_m: Annotated[float, Field(gt=0)] = 0.5
    clock_tolerance_ppm: Annotated[float, Field(gt=0)] = 50.0

    def roles(self, device: str) -> tuple[Role, ...]:
        """Recorded, plotted and exported; no test needs it."""
        return (OtherQuantity(device=device, topic=self.topic, fields=("tilt_x_rad", "tilt_y_rad")),)


def channel(settings: Tilt) -> Channel:
    """The two angles."""
    return Channel(settings.topic, "rig_driver_tilt.Tilt", FIELDS)


def encode(text: str) -> bytes:
    """A line with its check."""
    return f"{text}*{binascii.crc_hqx(text.encode(), 0xFFFF):04X}\r\n".encode()


def parse(line: bytes) -> Reading | str | None:
    """A sample, an answer, or None: damaged."""
    text, _, check = line.rpartition(b"*")
    if check != b"%04X" % binascii.crc_hqx(text, 0xFFFF):
        return None
    if found := SAMPLE.fullmatch(text):
        number, ms, x, y = map(int, found.groups())
        return Reading(number, (x * UNIT_RAD, y * UNIT_RAD), ms)
    return text.decode("ascii", "replace") if ANSWER.fullmatch(text) else None


def commands(model: str, serial: str) -> Commands:
    """What it takes and answers."""
    return Commands(b"START", b"STOP", {b"ID?": encode(f"I {model} {serial}")})


def far_end(device: str, settings: Tilt, world: Any) -> SimulatedSensor:
    """The device at the end of a simulated line."""

    def lines(numbers: Any, at: Any) -> bytes:
        rows = zip(numbers, *(at(i, i + 4) / settings.height_m / UNIT_RAD for i in (0, 1)), strict=True)
        return b"".join(encode(f"T {n % 1000:03d} {n * PERIOD_MS % 2**32:010d} {x:.0f} {y:.0f}") for n, x, y in rows)

    return SimulatedSensor(world.clock(device), PERIOD_MS * 1e-3, lines, commands("tilt-2", "4711"))


def open_device(device: str, settings: Tilt, talk: Talk) -> dict[str, Any]:
    """Query the identity, drop what an earlier stream left, start."""
    _, model, serial = asked(device, settings, talk, b"STOP\nID?\n").split(" ")
    talk.restart_decoding()
    talk.send(b"START\n")
    return {"model": model, "serial": serial}


DRIVER = Driver(
    name="tilt",
    settings=Tilt,
    claims=frozenset({"checksum", "counts exactly", "falls silent"}),
    channels=lambda settings: (channel(settings),),
    clocks=partial(line_clock, COUNT, "device_ms"),
    pipeline=lambda device, settings, identity: LinePipeline(
        device, channel(settings), COUNT, parse, settings.clock_tolerance_ppm, identity
    ),
    far_end=far_end,
    played=lambda settings, identity: PlayedSensor(commands(**identity)),
    open=open_device,
    stop=lambda settings, talk: talk.send(b"STOP\n"),
)
