"""CiA 402 drives as a driver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from daq.drivers.checks import Checks
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.contract import SpeedControl
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent


def _words(event: DeviceEvent) -> str:
    from daq.drivers.canopen import cia301

    code = int(event.facts["error_code"])
    return cia301.emergency_words(code) if code else ""


def _checks(settings: MotorDrive, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the drive's state and emergencies, and heartbeats of another node under the host's number."""
    from daq.drivers.cia402.status_checks import drive_checks

    return drive_checks(control, events, pipeline.host_beats.foreign)


_part = parts_of("daq.drivers.cia402")
DRIVER = Driver(
    name="cia402",
    settings=MotorDrive,
    example={"node_id": 5},
    claims=frozenset({"falls silent"}),
    channels=motor_channels,
    pipeline=_part("stream:DrivePipeline"),
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedDrive.of"),
    played=_part("far_end:PlayedDrive"),
    speed_source=_part("control:DriveControl"),
    recognise=_part("identity:recognise"),
    identity_request=_part("identity:identity_turns"),
)
