"""LabJack T4 and T7 as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import DeviceLine, Pipeline, Poller, SampleClock, SpeedControl, Talk
from daq.drivers.identification import Announcement
from daq.drivers.labjack.settings import LabJack, other_topic
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock

_NUMBER_WRAP = 2**32


class LabJackDriver(PlainDriver):
    """See Driver and AnnouncesItself: a device answers the search request of its maker."""

    name = "labjack"
    rest_s: float = 0.002
    settings = LabJack
    example: ClassVar[Mapping[str, Any]] = {
        "lasers": {"east": {"axis": "x", "input": "AIN0"}, "north": {"axis": "y", "input": "AIN1"}},
        "tacho": {"input": "AIN2"},
        "others": {"accel": {"input": "AIN3", "quantity": "acceleration_m_per_s2", "per_V": 10.0, "zero_V": 2.5}},
    }
    claims: frozenset[str] = frozenset({"falls silent"})

    @property
    def announcement(self) -> Announcement:
        """See AnnouncesItself."""
        from daq.drivers.labjack.identity import ANNOUNCEMENT

        return ANNOUNCEMENT

    def line(self, settings: LabJack) -> DeviceLine:
        """See Driver. The line is a TCP connection, which has no rate."""
        return DeviceLine(settings.port, 0)

    def channels(self, settings: LabJack) -> tuple[Channel, ...]:
        """See Driver: lasers and other quantities."""
        lasers = [channels.displacement_channel(laser.topic) for laser in settings.lasers.values()]
        others = [
            Channel(other_topic(name), f"rig.Analogue_{name}", ((other.quantity, "double"), ("scan", "fixed32")))
            for name, other in settings.others.items()
        ]
        return (*lasers, *others)

    def occasional(self, settings: LabJack) -> tuple[Channel, ...]:
        """See Driver: the index marks."""
        return () if settings.tacho is None else (channels.TACHO,)

    def clocks(self, settings: LabJack) -> tuple[SampleClock, ...]:
        """See Driver: the scans' clock, in the channels of the lasers."""
        rate, tolerance, tick_ns = (
            settings.scan_rate_Hz,
            settings.clock_tolerance_ppm,
            round(channels.DEVICE_TICK_S * 1e9),
        )
        return tuple(
            SampleClock(laser.topic, rate, tolerance, "device_ticks", tick_ns, _NUMBER_WRAP)
            for laser in settings.lasers.values()
        )

    def pipeline(self, device: str, settings: LabJack, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.labjack.stream import LabJackPipeline

        return LabJackPipeline(device, settings, {c.topic: c for c in self.channels(settings)}, identity)

    def poller(self, settings: LabJack, send: Callable[[bytes], None], clock: HostClock) -> Poller:
        """See AnswersOnRequest: reads of the stream, and of the errors of refused ones."""
        from daq.drivers.labjack import wire
        from daq.drivers.labjack.dialogue import ANSWER_S
        from daq.drivers.labjack.poller import StreamReads
        from daq.drivers.polling import Request, RequestLoop

        read = partial(wire.stream_request, inputs=len(settings.scan_list))
        return StreamReads(RequestLoop(Request(read, b"", settings.read_period_s, ANSWER_S), send, clock), send)

    def checks(
        self, settings: LabJack, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the origin of the inputs' scales."""
        warning = str(getattr(pipeline, "warning", ""))
        own = "from its flash"
        return {"scales": DeviceCheck("nominal" if warning else own, own, not warning, warning)}

    def far_end(self, device: str, settings: LabJack, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.labjack.far_end import SimulatedLabJack

        return SimulatedLabJack.of(device, settings, world)

    def played(self, settings: LabJack, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.labjack.played import PlayedLabJack

        return PlayedLabJack(settings, identity)

    def open(self, device: str, settings: LabJack, talk: Talk) -> dict[str, Any]:
        """See Driver."""
        from daq.drivers.labjack.dialogue import open_device

        return {"driver": self.name, "port": settings.port, **open_device(device, settings, talk)}

    def stop(self, talk: Talk) -> None:
        """See Driver."""
        from daq.drivers.labjack.dialogue import stop_device

        stop_device(talk)


DRIVER = LabJackDriver()
