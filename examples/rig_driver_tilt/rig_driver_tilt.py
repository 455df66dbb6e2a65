"""A two-axis inclinometer on a serial line, as a driver.

The device is silent until it receives START. Then it sends a line a sample, with a counter that wraps after 999, its
own time in ms, two angles in units of 1e-6 rad, and a CRC-16 of the characters before the asterisk:

    T 017 0000001700 -123 45*8F3A

It answers ID? with `I tilt-2 SERIAL`, and takes STOP.
"""

import binascii
import re
from typing import Annotated, Any

from pydantic import Field

from daq.channels import Channel
from daq.drivers.line_sensor import Commands, LineSensor, Motion, Reading
from daq.numbered.messages import Count
from rig_configs.device import DeviceSettings
from rig_configs.roles import OtherQuantity, Role

PERIOD_MS, UNIT_RAD = 10, 1e-6
FIELDS = (("tilt_x_rad", "double"), ("tilt_y_rad", "double"), ("count", "fixed32"), ("device_ms", "fixed64"))
SAMPLE = re.compile(r"T (\d{3}) (\d{10}) (-?\d{1,9}) (-?\d{1,9})")


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
    text = line.decode("ascii", "replace").rpartition("*")[0]
    if encode(text) != line + b"\r\n":
        return None
    if found := SAMPLE.fullmatch(text):
        number, ms, x, y = map(int, found.groups())
        return Reading(number, (x * UNIT_RAD, y * UNIT_RAD), ms)
    return text


def lines(settings: Tilt, numbers: Any, motion: Motion) -> bytes:
    """The samples of the simulated device: the angles follow from the motion of the disk."""
    x, y = (motion(i, i + 4) / settings.height_m / UNIT_RAD for i in (0, 1))
    rows = zip(numbers, x, y, strict=True)
    return b"".join(encode(f"T {n % 1000:03d} {n * PERIOD_MS % 2**32:010d} {x:.0f} {y:.0f}") for n, x, y in rows)


SENSOR = LineSensor(
    channel=channel,
    count=Count(1000, PERIOD_MS * 1e6, clock_size=2**32, clock_step=PERIOD_MS),
    encode=encode,
    parse=parse,
    lines=lines,
    commands=Commands("START", "STOP", "ID?", "I {model} {serial}", {"model": "tilt-2", "serial": "4711"}),
)
DRIVER = SENSOR.driver("tilt", Tilt, claims=frozenset({"checksum", "counts exactly", "falls silent"}))
