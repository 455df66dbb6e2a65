"""Sensors on CAN that a DBC file describes, as a driver."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.contract import DeviceLine, Pipeline, SampleClock, Talk
from daq.drivers.dbc.example import SETTINGS
from daq.drivers.dbc.settings import CanSensors
from daq.drivers.plain import PlainDriver
from daq.drivers.simulated import FarEnd
from daq.drivers.stream_stop import stop_stream
from daq.transports.can_frames import CLOSE_BUS, open_bus


class DbcDriver(PlainDriver):
    """See Driver. The adapter is set to the bit rate and opened; the sensors send without a request."""

    name = "dbc"
    settings = CanSensors
    rest_s: float = 0.01
    example: ClassVar[Mapping[str, Any]] = SETTINGS
    claims: frozenset[str] = frozenset({"counts exactly", "falls silent"})

    def line(self, settings: CanSensors) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)

    def channels(self, settings: CanSensors) -> tuple[Channel, ...]:
        """See Driver: the displacements."""
        return tuple(channels.displacement_channel(laser.topic) for laser in settings.lasers)

    def occasional(self, settings: CanSensors) -> tuple[Channel, ...]:
        """See Driver: the further signals."""
        return tuple(
            Channel(f"can/{name}", f"rig.Can_{name}", tuple((field, "double") for field in quantity.fields))
            for name, quantity in settings.quantities.items()
        )

    def clocks(self, settings: CanSensors) -> tuple[SampleClock, ...]:
        """See Driver: the clocks of displacements with a counter or a timestamp."""
        tick_ns = round(channels.DEVICE_TICK_S * 1e9)
        return tuple(
            SampleClock(
                table.topic,
                table.rate_Hz,
                table.clock_tolerance_ppm,
                "device_ticks",
                tick_ns,
                2**32,
            )
            for group in settings.groups()
            if group.has_clock
            for table, _ in group.lasers
        )

    def pipeline(self, device: str, settings: CanSensors, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.dbc.stream import CanPipeline

        by_topic = {channel.topic: channel for channel in (*self.channels(settings), *self.occasional(settings))}
        return CanPipeline(device, settings, by_topic, identity)

    def far_end(self, device: str, settings: CanSensors, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.dbc.far_end import SimulatedCanSensors

        return SimulatedCanSensors.of(device, settings, world)

    def open(self, device: str, settings: CanSensors, talk: Talk) -> dict[str, Any]:
        """See Driver; sensors that are described by a DBC file alone cannot be queried."""
        if not settings.port.startswith("can:"):  # a bus of python-can holds no old frames
            stop_stream(talk, CLOSE_BUS)
            talk.restart_decoding()
        talk.send(open_bus(settings.bitrate))
        digest = hashlib.sha256(settings.dbc_text.encode()).hexdigest()
        return {"driver": self.name, "port": settings.port, "bitrate": settings.bitrate, "dbc_sha256": digest}

    def stop(self, talk: Talk) -> None:
        """See Driver: the adapter closes the bus."""
        talk.send(CLOSE_BUS)


DRIVER = DbcDriver()
