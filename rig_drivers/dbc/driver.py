"""Sensors on CAN that a DBC file describes, as a driver."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.contract import DeviceLine, Pipeline, SampleClock, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import TICK_NS
from daq.drivers.stream_stop import stop_stream
from daq.transports.can_frames import CLOSE_BUS, open_bus
from rig_drivers.dbc.example import SETTINGS
from rig_drivers.dbc.settings import CanSensors


def _line(settings: CanSensors) -> DeviceLine:
    return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)


def _channels(settings: CanSensors) -> tuple[Channel, ...]:
    """Return the displacements."""
    return tuple(channels.displacement_channel(laser.topic) for laser in settings.lasers)


def _occasional(settings: CanSensors) -> tuple[Channel, ...]:
    """Return the further signals."""
    return tuple(
        Channel(f"can/{name}", f"rig.Can_{name}", tuple((field, "double") for field in quantity.fields))
        for name, quantity in settings.quantities.items()
    )


def _clocks(settings: CanSensors) -> tuple[SampleClock, ...]:
    """Return the clocks of displacements with a counter or a timestamp."""
    return tuple(
        SampleClock(table.topic, table.rate_Hz, table.clock_tolerance_ppm, "device_ticks", TICK_NS, 2**32)
        for group in settings.groups()
        if group.has_clock
        for table, _ in group.lasers
    )


def _pipeline(device: str, settings: CanSensors, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.dbc.stream import CanPipeline

    by_topic = {channel.topic: channel for channel in (*_channels(settings), *_occasional(settings))}
    return CanPipeline(device, settings, by_topic, identity)


def _open(device: str, settings: CanSensors, talk: Talk) -> dict[str, Any]:
    """Set the adapter to the bit rate and open it; sensors that a DBC file describes alone cannot be queried."""
    if not settings.port.startswith("can:"):  # a bus of python-can holds no old frames
        stop_stream(talk, CLOSE_BUS)
        talk.restart_decoding()
    talk.send(open_bus(settings.bitrate))
    digest = hashlib.sha256(settings.dbc_text.encode()).hexdigest()
    return {"driver": "dbc", "port": settings.port, "bitrate": settings.bitrate, "dbc_sha256": digest}


def _stop(settings: CanSensors, talk: Talk) -> None:
    """Close the bus at the adapter."""
    talk.send(CLOSE_BUS)


_part = parts_of("rig_drivers.dbc")
DRIVER = Driver(
    name="dbc",
    settings=CanSensors,
    example=SETTINGS,
    claims=frozenset({"counts exactly", "falls silent"}),
    line=_line,
    channels=_channels,
    occasional=_occasional,
    clocks=_clocks,
    pipeline=_pipeline,
    far_end=_part("far_end:SimulatedCanSensors.of"),
    open=_open,
    stop=_stop,
)
