# pyright: strict
"""RotorLink nodes behind XBee modules as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import Line, SampleClock, Talk
from daq.drivers.items import Event
from daq.drivers.xbee.dialogue import identify
from daq.drivers.xbee.locks import XBeeLocks
from daq.drivers.xbee.settings import XBeeNode
from daq.drivers.xbee.stream import XBeePipeline


class XBee:
    """See Driver."""

    name = "xbee"
    rest_s = 0.01
    settings = XBeeNode

    def line(self, settings: XBeeNode) -> Line:
        """See Driver."""
        return Line(settings.port, settings.baud)

    def channels(self, settings: XBeeNode) -> tuple[Channel, ...]:
        """See Driver; index marks come only while the rotor turns."""
        return (channels.PENDULUMS,)

    def clocks(self, settings: XBeeNode) -> tuple[SampleClock, ...]:
        """See Driver."""
        return (SampleClock(channels.PENDULUMS.topic, settings.rate_Hz, settings.clock_tolerance_ppm, "node_time_us",
                            1000, 2**32),)  # fmt: skip

    def pipeline(self, device: str, settings: XBeeNode, identity: Mapping[str, Any]) -> XBeePipeline:
        """See Driver."""
        return XBeePipeline(device, settings, identity)

    def words(self, event: Event) -> str:
        """See Driver."""
        return event.text

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: XBeeNode, talk: Talk) -> dict[str, Any]:
        """See Driver; the module is asked who it is, the node streams from the moment it has power."""
        return identify(device, settings, talk)

    def stop(self, talk: Talk) -> None:
        """See Driver; a node goes on for as long as it has power."""

    def locks(self, settings: XBeeNode, send: Callable[[bytes], None]) -> XBeeLocks:
        """See MovesLocks."""
        return XBeeLocks(settings, send)


DRIVER = XBee()
