"""CiA 402 drives as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.drivers.can_lines import ADAPTER_BAUD
from daq.drivers.checks import Checks
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.contract import DeviceLine, Pipeline, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.drivers.played import PlayedDevice
from daq.items import DeviceEvent


def _line(settings: MotorDrive) -> DeviceLine:
    return DeviceLine(settings.port, ADAPTER_BAUD, settings.bitrate)


def _pipeline(device: str, settings: MotorDrive, identity: Mapping[str, Any]) -> Pipeline:
    from daq.drivers.cia402.stream import DrivePipeline

    return DrivePipeline(device, settings)


def _words(event: DeviceEvent) -> str:
    from daq.drivers.canopen import cia301

    code = int(event.facts["error_code"])
    return cia301.emergency_words(code) if code else ""


def _checks(settings: MotorDrive, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the drive's state and emergencies, and heartbeats of another node under the host's number."""
    from daq.drivers.cia402.status_checks import drive_checks

    return drive_checks(control, events, pipeline.host_beats.foreign)


def _played(settings: MotorDrive, identity: Mapping[str, Any]) -> PlayedDevice:
    from daq.drivers.cia402.played import PlayedDrive

    return PlayedDrive(settings)


def _open(device: str, settings: MotorDrive, talk: Talk) -> dict[str, Any]:
    """Return the node's number; the drive's command (`control`) starts the network."""
    return {"driver": "cia402", "node_id": settings.node_id}


_part = parts_of("daq.drivers.cia402")
DRIVER = Driver(
    name="cia402",
    settings=MotorDrive,
    example={"node_id": 5},
    claims=frozenset({"falls silent"}),
    line=_line,
    channels=motor_channels,
    pipeline=_pipeline,
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedDrive.of"),
    played=_played,
    open=_open,
    speed_source=_part("control:DriveControl"),
    recognise=_part("identity:recognise"),
    identity_request=_part("identity:identity_turns"),
)
