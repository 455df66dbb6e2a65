"""VESC motor controllers on a CAN bus as a driver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from daq.drivers.can_lines import close_bus
from daq.drivers.checks import Checks
from daq.drivers.contract import RotorGuard, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from daq.transports.can_frames import open_bus
from rig_drivers.vesc import driver as vesc
from rig_drivers.vesc_can.settings import VescCan

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _checks(settings: VescCan, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the state, the faults, and the rate of the status messages."""
    from rig_drivers.vesc_can.stream import status_check

    found = vesc.checks(settings, pipeline, control, events)
    return {**found, "status_Hz": status_check(settings, pipeline.status_watch)}


def _open(device: str, settings: VescCan, talk: Talk) -> dict[str, Any]:
    """Open the bus and query the controller; it is polled by its command (`control`)."""
    from rig_drivers.vesc.dialogue import identify
    from rig_drivers.vesc.wire import firmware_version
    from rig_drivers.vesc_can.wire import on_bus

    talk.send(open_bus(settings.bitrate))
    query = on_bus(firmware_version(), settings.controller_id, settings.host_id)
    advice = (
        f"Is the controller powered, its CAN mode VESC, are its number ({settings.controller_id}) and the bit rate "
        f"({settings.bitrate} bit/s) right, is the bus terminated?"
    )
    found = identify(device, settings, talk, query, advice)
    return {"controller_id": settings.controller_id, **found}


def _speed_source(
    settings: VescCan, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
) -> SpeedControl:
    from rig_drivers.vesc.control import VescControl
    from rig_drivers.vesc_can.wire import on_bus

    encode = partial(on_bus, controller_id=settings.controller_id, host_id=settings.host_id)
    return VescControl(settings, send, clock, guard, encode)


_part = parts_of("rig_drivers.vesc_can")
DRIVER = Driver(
    name="vesc_can",
    settings=VescCan,
    example={**vesc.EXAMPLE, "controller_id": 23},
    claims=frozenset({"falls silent"}),
    channels=motor_channels,
    pipeline=_part("stream:VescCanPipeline"),
    words=vesc.words,
    checks=_checks,
    far_end=_part("far_end:SimulatedVescCan.of"),
    played=_part("far_end:PlayedVescCan"),
    open=_open,
    stop=close_bus,
    speed_source=_speed_source,
)
