"""VESC motor controllers on a CAN bus as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, open_bus
from rig_drivers.vesc import driver as vesc
from rig_drivers.vesc_can.settings import VescCan

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _line(settings: VescCan) -> DeviceLine:
    return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)


def _pipeline(device: str, settings: VescCan, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.vesc_can.stream import can_pipeline

    return can_pipeline(device, settings)


def _checks(settings: VescCan, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the state, the faults, and the rate of the status messages."""
    from rig_drivers.vesc_can.status_watch import status_check

    found = vesc.checks(settings, pipeline, control, events)
    return {**found, "status_Hz": status_check(settings, pipeline.status)}


def _open(device: str, settings: VescCan, talk: Talk) -> dict[str, Any]:
    """Open the bus and query the controller; it is polled by its command (`control`)."""
    from rig_drivers.vesc.dialogue import identify
    from rig_drivers.vesc_can.wire import CanCommands

    talk.send(open_bus(settings.bitrate))
    query = CanCommands(settings.controller_id, settings.host_id).firmware_version()
    advice = (
        f"Is the controller powered, its CAN mode VESC, are its number ({settings.controller_id}) and the bit rate "
        f"({settings.bitrate} bit/s) right, is the bus terminated?"
    )
    found = identify(device, settings, talk, query, advice)
    return {"driver": "vesc_can", "controller_id": settings.controller_id, **found}


def _stop(settings: VescCan, talk: Talk) -> None:
    """Close the bus; the controller's command (`control`) has stopped it."""
    talk.send(CLOSE_BUS)


def _speed_source(
    settings: VescCan, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
) -> SpeedControl:
    from rig_drivers.vesc.control import VescControl
    from rig_drivers.vesc_can.wire import CanCommands

    return VescControl(settings, send, clock, guard, CanCommands(settings.controller_id, settings.host_id))


_part = parts_of("rig_drivers.vesc_can")
DRIVER = Driver(
    name="vesc_can",
    settings=VescCan,
    example={**vesc.EXAMPLE, "controller_id": 23},
    claims=frozenset({"falls silent"}),
    line=_line,
    channels=motor_channels,
    pipeline=_pipeline,
    words=vesc.words,
    checks=_checks,
    far_end=_part("far_end:SimulatedVescCan.of"),
    played=_part("played:PlayedVescCan"),
    open=_open,
    stop=_stop,
    speed_source=_speed_source,
)
