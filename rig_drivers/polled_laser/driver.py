"""Polled displacement sensors as a driver."""

from __future__ import annotations

from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels
from rig_drivers.polled_laser.settings import PolledLaser

_part = parts_of("rig_drivers.polled_laser")
DRIVER = Driver(
    name="polled_laser",
    settings=PolledLaser,
    pause_s=0.001,
    example={"axis": "x", "dialect": "LK-G"},
    claims=frozenset({"falls silent"}),
    usual=(
        {"dialect": "LK-G"},
        {"dialect": "LK-G5000"},
        {"dialect": "HL-G1"},
        {"dialect": "IL", "baud": 9_600, "rate_Hz": 20},
        {"dialect": "LK-G", "baud": 9_600, "rate_Hz": 20},
    ),
    channels=displacement_channels,
    pipeline=_part("stream:PolledPipeline"),
    poller=_part("poller:SensorPoller"),
    far_end=_part("far_end:SimulatedPolledLaser.of"),
    played=_part("far_end:PlayedPolledLaser"),
    open=_part("dialogue:identify"),
    identity_request=_part("dialogue:identity_turns"),
)
