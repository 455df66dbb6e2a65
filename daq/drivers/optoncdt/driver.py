# pyright: strict
"""optoNCDT sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import Line, SampleClock, Talk
from daq.drivers.items import Event
from daq.drivers.optoncdt import wire
from daq.drivers.optoncdt.blocks import compile_loop
from daq.drivers.optoncdt.dialogue import configure
from daq.drivers.optoncdt.stream import LaserPipeline
from rig_configs.schema import Laser


class OptoNcdt:
    """See Driver."""

    name = "optoncdt"
    rest_s = 0.02

    def line(self, settings: Laser) -> Line:
        """See Driver."""
        return Line(settings.port, settings.baud)

    def channels(self, settings: Laser) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.LASER_X if settings.axis == "x" else channels.LASER_Y,)

    def clocks(self, settings: Laser) -> tuple[SampleClock, ...]:
        """See Driver."""
        (channel,) = self.channels(settings)
        tick_ns = round(wire.TICK_S * 1e9)
        return (SampleClock(channel.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "device_ticks", tick_ns,
                            wire.COUNTER_WRAP),)  # fmt: skip

    def pipeline(self, device: str, settings: Laser, identity: Mapping[str, Any]) -> LaserPipeline:
        """See Driver."""
        (channel,) = self.channels(settings)
        return LaserPipeline(device, settings, channel, identity)

    def words(self, event: Event) -> str:
        """See Driver."""
        return event.text

    def prepare(self) -> None:
        """See Driver."""
        compile_loop()

    def open(self, device: str, settings: Laser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        return configure(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        talk.send(b"OUTPUT NONE\n")


DRIVER = OptoNcdt()
