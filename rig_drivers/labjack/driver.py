"""LabJack T4 and T7 as a driver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SampleClock, SpeedControl
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import TICK_NS
from daq.items import DeviceEvent
from rig_drivers.labjack.settings import LabJack, other_channel

_EXAMPLE = {
    "lasers": {"east": {"axis": "x", "input": "AIN0"}, "north": {"axis": "y", "input": "AIN1"}},
    "tacho": {"input": "AIN2"},
    "others": {"accel": {"input": "AIN3", "quantity": "acceleration_m_per_s2", "per_V": 10.0, "zero_V": 2.5}},
}


def _channels(settings: LabJack) -> tuple[Channel, ...]:
    """Return the channels of lasers and other quantities."""
    lasers = [channels.displacement_channel(laser.topic) for laser in settings.lasers.values()]
    others = [other_channel(name, other) for name, other in settings.others.items()]
    return (*lasers, *others)


def _marks(settings: LabJack) -> tuple[Channel, ...]:
    return () if settings.tacho is None else (channels.TACHO,)


def _clocks(settings: LabJack) -> tuple[SampleClock, ...]:
    """Return the scans' clock, in the channels of the lasers."""
    rate, tolerance = settings.scan_rate_Hz, settings.clock_tolerance_ppm
    return tuple(
        SampleClock(laser.topic, rate, tolerance, "device_ticks", TICK_NS, 2**32) for laser in settings.lasers.values()
    )


def _checks(settings: LabJack, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the origin of the inputs' scales."""
    warning, own = str(pipeline.warning), "from its flash"
    return {"scales": DeviceCheck("nominal" if warning else own, own, not warning, warning)}


_part = parts_of("rig_drivers.labjack")
DRIVER = Driver(
    name="labjack",
    settings=LabJack,
    pause_s=0.002,
    example=_EXAMPLE,
    claims=frozenset({"falls silent"}),
    channels=_channels,
    occasional=_marks,
    clocks=_clocks,
    pipeline=_part("stream:LabJackPipeline"),
    poller=_part("poller:StreamReads"),
    checks=_checks,
    far_end=_part("far_end:SimulatedLabJack.of"),
    played=_part("far_end:PlayedLabJack"),
    open=_part("dialogue:open_device"),
    stop=_part("dialogue:stop_device"),
    announcement=_part("dialogue:announcement"),
)
