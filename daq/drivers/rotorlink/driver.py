# pyright: strict
"""RotorLink nodes as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import Line, SampleClock, Talk
from daq.drivers.items import Event
from daq.drivers.rotorlink.locks import NodeLocks
from daq.drivers.rotorlink.stream import NodePipeline
from rig_configs.schema import EncoderNode


class RotorLink:
    """See Driver."""

    name = "rotorlink"
    rest_s = 0.01

    def line(self, settings: EncoderNode) -> Line:
        """See Driver."""
        return Line(settings.port, settings.baud)

    def channels(self, settings: EncoderNode) -> tuple[Channel, ...]:
        """See Driver; index marks come only while the rotor turns."""
        return (channels.PENDULUMS,)

    def clocks(self, settings: EncoderNode) -> tuple[SampleClock, ...]:
        """See Driver."""
        return (SampleClock(channels.PENDULUMS.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "node_time_us",
                            1000, 2**32),)  # fmt: skip

    def pipeline(self, device: str, settings: EncoderNode, identity: Mapping[str, Any]) -> NodePipeline:
        """See Driver."""
        return NodePipeline(device, settings)

    def words(self, event: Event) -> str:
        """See Driver."""
        return event.text

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: EncoderNode, talk: Talk) -> dict[str, Any]:
        """See Driver; a node streams from the moment it has power."""
        return {"driver": self.name, "port": settings.port}

    def stop(self, talk: Talk) -> None:
        """See Driver; a node goes on for as long as it has power."""

    def locks(self, settings: EncoderNode, send: Callable[[bytes], None]) -> NodeLocks:
        """See MovesLocks."""
        return NodeLocks(send)


DRIVER = RotorLink()
