"""ODrive motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from daq.drivers.can_lines import close_bus
from daq.drivers.checks import Checks
from daq.drivers.contract import SpeedControl
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from rig_drivers.odrive.settings import Odrive


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


_part = parts_of("rig_drivers.odrive")
DRIVER = Driver(
    name="odrive",
    settings=Odrive,
    example={"node_id": 1, "firmware": "0.6", "watchdog_s": 0.5},
    claims=frozenset({"falls silent"}),
    channels=motor_channels,
    pipeline=_part("stream:OdrivePipeline"),
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedOdrive.of"),
    played=_part("far_end:PlayedOdrive"),
    open=_part("dialogue:identify"),
    stop=close_bus,
    speed_source=_part("control:OdriveControl"),
)
