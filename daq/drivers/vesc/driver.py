# pyright: strict
"""VESC motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import Line, RotorGuard, SampleClock, Talk
from daq.drivers.items import Event
from daq.drivers.vesc import settings as tables
from daq.drivers.vesc import wire
from daq.drivers.vesc.control import VescControl
from daq.drivers.vesc.dialogue import identify
from daq.drivers.vesc.stream import VescPipeline
from daq.transports.host_clock import HostClock


class VescDriver:
    """See Driver."""

    name = "vesc"
    rest_s = 0.01
    settings = tables.Vesc

    def line(self, settings: tables.Vesc) -> Line:
        """See Driver."""
        return Line(settings.port, settings.baud)

    def channels(self, settings: tables.Vesc) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def clocks(self, settings: tables.Vesc) -> tuple[SampleClock, ...]:
        """See Driver; a controller has no clock, the host's time counts."""
        return ()

    def pipeline(self, device: str, settings: tables.Vesc, identity: Mapping[str, Any]) -> VescPipeline:
        """See Driver."""
        return VescPipeline(device, settings)

    def words(self, event: Event) -> str:
        """See Driver."""
        code = int(event.facts["error_code"])
        return wire.fault_words(code) if code else ""

    def prepare(self) -> None:
        """See Driver."""

    def open(self, device: str, settings: tables.Vesc, talk: Talk) -> dict[str, Any]:
        """See Driver; it reports once it is asked, by who holds it (`control`)."""
        return {"driver": self.name, **identify(device, settings, talk)}

    def stop(self, talk: Talk) -> None:
        """See Driver; who holds the controller has stopped it (`control`)."""

    def speed_source(
        self, settings: tables.Vesc, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> VescControl:
        """See TurnsRotor."""
        return VescControl(settings, send, clock, guard)


DRIVER = VescDriver()
