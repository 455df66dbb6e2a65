"""One pipeline per device: bytes in, samples and events out.

Live recording and replay run the same object on the same bytes with the same host times, so decoding a log's raw
bytes again gives its decoded channels bit for bit. A pipeline does no I/O and reads no clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from daq import channels
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.items import Batch, Event
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.drivers.rotorlink.stream import NodePipeline
from rig_configs.schema import Devices


class Pipeline(Protocol):
    """What turns one device's bytes into samples."""

    losses: dict[str, int]

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """Take one read (RX) or one write (TX) with the host time it happened."""
        ...


def make_pipelines(devices: Devices, identities: Mapping[str, Mapping[str, Any]]) -> dict[str, Pipeline]:
    """Fresh pipelines for all devices of a rig.

    Args:
        identities: what each device said of itself when it was opened ("words" of a laser, for instance).
    """
    return {
        "laser_x": LaserPipeline("laser_x", devices.laser_x, channels.LASER_X, identities.get("laser_x", {})),
        "laser_y": LaserPipeline("laser_y", devices.laser_y, channels.LASER_Y, identities.get("laser_y", {})),
        "encoder": NodePipeline("encoder", devices.encoder),
        "drive": DrivePipeline("drive", devices.drive),
    }
