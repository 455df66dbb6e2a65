# pyright: strict
"""RF60x sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import Line, SampleClock, Talk
from daq.drivers.items import Event
from daq.drivers.optoncdt.spikes import compile_watch
from daq.drivers.riftek import dialogue, stream, wire
from daq.drivers.riftek.decoder import StreamDecoder
from daq.drivers.riftek.settings import RiftekLaser
from daq.drivers.riftek.stream import RiftekPipeline


class Riftek:
    """See Driver."""

    name = "riftek"
    rest_s = 0.02
    settings = RiftekLaser

    def line(self, settings: RiftekLaser) -> Line:
        """See Driver; a line has no parity yet, so that a real sensor's has to be set at the port beforehand."""
        return Line(settings.port, settings.baud)

    def channels(self, settings: RiftekLaser) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.LASER_X if settings.axis == "x" else channels.LASER_Y,)

    def clocks(self, settings: RiftekLaser) -> tuple[SampleClock, ...]:
        """See Driver."""
        (channel,) = self.channels(settings)
        return (SampleClock(channel.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "device_ticks",
                            stream.TICK_NS, stream.COUNTER_WRAP),)  # fmt: skip

    def pipeline(self, device: str, settings: RiftekLaser, identity: Mapping[str, Any]) -> RiftekPipeline:
        """See Driver."""
        (channel,) = self.channels(settings)
        return RiftekPipeline(device, settings, channel, identity)

    def words(self, event: Event) -> str:
        """See Driver."""
        return event.text

    def prepare(self) -> None:
        """See Driver."""
        compile_watch()
        StreamDecoder().feed(wire.results(np.zeros(8, np.int64), np.arange(8)))

    def open(self, device: str, settings: RiftekLaser, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        return dialogue.configure(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        dialogue.stop(talk)


DRIVER = Riftek()
