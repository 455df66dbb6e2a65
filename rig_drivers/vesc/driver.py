"""VESC motor controllers as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.drivers.checks import Checks
from daq.drivers.contract import SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from rig_drivers.vesc.settings import Vesc, VescMotor

_FAULTY = ("FAULT", "KILL SWITCH OPEN", "UNKNOWN")
EXAMPLE: Mapping[str, Any] = {"pole_pairs": 7, "timeout_s": 1.0, "brake_A": 5.0}


def words(event: DeviceEvent) -> str:
    """Return the text of a fault; empty if it has ended."""
    from rig_drivers.vesc import wire

    code = int(event.facts["error_code"])
    return wire.fault_words(code) if code else ""


def checks(settings: VescMotor, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the controller's state, and the faults it reported."""
    from daq.drivers.fault_checks import controller_checks
    from rig_drivers.vesc.wire import fault_words

    return controller_checks(control, events, fault_words, _FAULTY)


def _open(device: str, settings: Vesc, talk: Talk) -> dict[str, Any]:
    """Query the controller. It reports only on request, by its command (`control`)."""
    from rig_drivers.vesc import wire
    from rig_drivers.vesc.dialogue import identify

    advice = f"Is the controller powered, its serial port enabled at {settings.baud} baud, are both wires right?"
    return identify(device, settings, talk, wire.firmware_version(), advice)


_part = parts_of("rig_drivers.vesc")
DRIVER = Driver(
    name="vesc",
    settings=Vesc,
    example=EXAMPLE,
    claims=frozenset({"checksum", "falls silent"}),
    channels=motor_channels,
    pipeline=_part("stream:VescPipeline"),
    words=words,
    checks=checks,
    far_end=_part("far_end:SimulatedVesc.of"),
    played=_part("far_end:PlayedVesc"),
    open=_open,
    speed_source=_part("control:VescControl"),
    identity_request=_part("dialogue:identity_turns"),
    announcement=_part("dialogue:announcement"),
)
