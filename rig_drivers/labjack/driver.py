"""LabJack T4 and T7 as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import DeviceLine, Pipeline, Poller, SampleClock, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.identification import Announcement
from daq.drivers.plain import TICK_NS
from daq.items import DeviceEvent
from rig_drivers.labjack.settings import LabJack, other_topic

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock

_NUMBER_WRAP = 2**32
_EXAMPLE = {
    "lasers": {"east": {"axis": "x", "input": "AIN0"}, "north": {"axis": "y", "input": "AIN1"}},
    "tacho": {"input": "AIN2"},
    "others": {"accel": {"input": "AIN3", "quantity": "acceleration_m_per_s2", "per_V": 10.0, "zero_V": 2.5}},
}


def _announcement() -> Announcement:
    """Return how a device answers the search request of its maker."""
    from rig_drivers.labjack.identity import ANNOUNCEMENT

    return ANNOUNCEMENT


def _line(settings: LabJack) -> DeviceLine:
    """Return a TCP connection, which has no rate."""
    return DeviceLine(settings.port, 0)


def _channels(settings: LabJack) -> tuple[Channel, ...]:
    """Return the channels of lasers and other quantities."""
    lasers = [channels.displacement_channel(laser.topic) for laser in settings.lasers.values()]
    others = [
        Channel(other_topic(name), f"rig.Analogue_{name}", ((other.quantity, "double"), ("scan", "fixed32")))
        for name, other in settings.others.items()
    ]
    return (*lasers, *others)


def _marks(settings: LabJack) -> tuple[Channel, ...]:
    return () if settings.tacho is None else (channels.TACHO,)


def _clocks(settings: LabJack) -> tuple[SampleClock, ...]:
    """Return the scans' clock, in the channels of the lasers."""
    rate, tolerance = settings.scan_rate_Hz, settings.clock_tolerance_ppm
    return tuple(
        SampleClock(laser.topic, rate, tolerance, "device_ticks", TICK_NS, _NUMBER_WRAP)
        for laser in settings.lasers.values()
    )


def _pipeline(device: str, settings: LabJack, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.labjack.stream import LabJackPipeline

    return LabJackPipeline(device, settings, {c.topic: c for c in _channels(settings)}, identity)


def _poller(settings: LabJack, send: Callable[[bytes], None], clock: HostClock) -> Poller:
    """Return reads of the stream, and of the errors of refused ones."""
    from daq.drivers.polling import Request, RequestLoop
    from rig_drivers.labjack import wire
    from rig_drivers.labjack.dialogue import ANSWER_S
    from rig_drivers.labjack.poller import StreamReads

    read = partial(wire.stream_request, inputs=len(settings.scan_list))
    return StreamReads(RequestLoop(Request(read, b"", settings.read_period_s, ANSWER_S), send, clock), send)


def _checks(settings: LabJack, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the origin of the inputs' scales."""
    warning, own = str(pipeline.warning), "from its flash"
    return {"scales": DeviceCheck("nominal" if warning else own, own, not warning, warning)}


def _open(device: str, settings: LabJack, talk: Talk) -> dict[str, Any]:
    from rig_drivers.labjack.dialogue import open_device

    return {"driver": "labjack", "port": settings.port, **open_device(device, settings, talk)}


def _stop(settings: LabJack, talk: Talk) -> None:
    from rig_drivers.labjack.dialogue import stop_device

    stop_device(talk)


_part = parts_of("rig_drivers.labjack")
DRIVER = Driver(
    name="labjack",
    settings=LabJack,
    rest_s=0.002,
    example=_EXAMPLE,
    claims=frozenset({"falls silent"}),
    line=_line,
    channels=_channels,
    occasional=_marks,
    clocks=_clocks,
    pipeline=_pipeline,
    poller=_poller,
    checks=_checks,
    far_end=_part("far_end:SimulatedLabJack.of"),
    played=_part("played:PlayedLabJack"),
    open=_open,
    stop=_stop,
    announcement=_announcement,
)
