"""Sensors on CAN that a DBC file describes, as a driver."""

from __future__ import annotations

import hashlib
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import close_bus
from daq.drivers.contract import SampleClock, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import TICK_NS
from daq.drivers.questions import stop_stream
from daq.transports.can_frames import CLOSE_BUS, open_bus
from rig_drivers.dbc.example import SETTINGS
from rig_drivers.dbc.settings import CanSensors, quantity_channel


def _channels(settings: CanSensors) -> tuple[Channel, ...]:
    """Return the displacements."""
    return tuple(channels.displacement_channel(laser.topic) for laser in settings.lasers)


def _occasional(settings: CanSensors) -> tuple[Channel, ...]:
    """Return the further signals."""
    return tuple(quantity_channel(name, quantity) for name, quantity in settings.quantities.items())


def _clocks(settings: CanSensors) -> tuple[SampleClock, ...]:
    """Return the clocks of displacements with a counter or a timestamp."""
    return tuple(
        SampleClock(table.topic, table.rate_Hz, table.clock_tolerance_ppm, "device_ticks", TICK_NS, 2**32)
        for group in settings.groups()
        if group.has_clock
        for table, _ in group.lasers
    )


def _open(device: str, settings: CanSensors, talk: Talk) -> dict[str, Any]:
    """Set the adapter to the bit rate and open it; sensors that a DBC file describes alone cannot be queried."""
    if not settings.port.startswith("can:"):  # a bus of python-can holds no old frames
        stop_stream(talk, CLOSE_BUS)
        talk.restart_decoding()
    talk.send(open_bus(settings.bitrate))
    digest = hashlib.sha256(settings.dbc_text.encode()).hexdigest()
    return {"bitrate": settings.bitrate, "dbc_sha256": digest}


_part = parts_of("rig_drivers.dbc")
DRIVER = Driver(
    name="dbc",
    settings=CanSensors,
    example=SETTINGS,
    claims=frozenset({"counts exactly", "falls silent"}),
    channels=_channels,
    occasional=_occasional,
    clocks=_clocks,
    pipeline=_part("stream:CanPipeline"),
    far_end=_part("far_end:SimulatedCanSensors.of"),
    open=_open,
    stop=close_bus,
)
