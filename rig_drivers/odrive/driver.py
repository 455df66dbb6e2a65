"""ODrive motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from daq.transports.can_frames import CLOSE_BUS
from rig_drivers.odrive.settings import Odrive


def _line(settings: Odrive) -> DeviceLine:
    return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)


def _pipeline(device: str, settings: Odrive, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.odrive.stream import OdrivePipeline

    return OdrivePipeline(device, settings)


def _words(event: DeviceEvent) -> str:
    """Return the text of an error. The event contains the firmware, on which the meaning of the code depends."""
    from rig_drivers.odrive import wire

    code = int(event.facts["error_code"])
    return wire.error_words(str(event.facts.get("firmware", "0.6")), code) if code else ""


def _checks(settings: Odrive, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the axis' state, and the errors it reported."""
    from daq.drivers.fault_checks import controller_checks
    from rig_drivers.odrive.wire import error_words

    return controller_checks(
        control, events, lambda code: error_words(settings.firmware, code), ("FAULT", "UNKNOWN", "UNDEFINED")
    )


def _open(device: str, settings: Odrive, talk: Talk) -> dict[str, Any]:
    """Query the axis, which receives no command; a request feeds the watchdog of firmware 0.5."""
    from rig_drivers.odrive.dialogue import identify

    return {"driver": "odrive", **identify(device, settings, talk)}


def _stop(settings: Odrive, talk: Talk) -> None:
    """Close the bus; the controller's command (`control`) has stopped it."""
    talk.send(CLOSE_BUS)


_part = parts_of("rig_drivers.odrive")
DRIVER = Driver(
    name="odrive",
    settings=Odrive,
    example={"node_id": 1, "firmware": "0.6", "watchdog_s": 0.5},
    claims=frozenset({"falls silent"}),
    line=_line,
    channels=motor_channels,
    pipeline=_pipeline,
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedOdrive.of"),
    played=_part("played:PlayedOdrive"),
    open=_open,
    stop=_stop,
    speed_source=_part("control:OdriveControl"),
)
