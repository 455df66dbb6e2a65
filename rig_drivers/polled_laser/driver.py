"""Polled displacement sensors as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from daq.drivers.contract import DeviceLine, Pipeline, Poller, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels
from daq.drivers.played import PlayedDevice
from rig_drivers.polled_laser.settings import PolledLaser

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _line(settings: PolledLaser) -> DeviceLine:
    return DeviceLine(settings.port, settings.baud, parity=settings.parity)


def _pipeline(device: str, settings: PolledLaser, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.polled_laser.stream import PolledPipeline

    (channel,) = displacement_channels(settings)
    return PolledPipeline(device, settings, channel)


def _poller(settings: PolledLaser, send: Callable[[bytes], None], clock: HostClock) -> Poller:
    from rig_drivers.polled_laser import wire
    from rig_drivers.polled_laser.poller import SensorPoller, Turns
    from rig_drivers.polled_laser.stream import LATEST_S

    turns = Turns(wire.DIALECTS[settings.dialect], settings.output)
    return SensorPoller(turns, 1.0 / settings.rate_Hz, 2 * LATEST_S, send, clock)


def _played(settings: PolledLaser, identity: Mapping[str, Any]) -> PlayedDevice:
    from rig_drivers.polled_laser.played import PlayedPolledLaser

    return PlayedPolledLaser(settings)


def _open(device: str, settings: PolledLaser, talk: Talk) -> dict[str, Any]:
    from rig_drivers.polled_laser.dialogue import identify

    return {"driver": "polled_laser", **identify(device, settings, talk)}


_part = parts_of("rig_drivers.polled_laser")
DRIVER = Driver(
    name="polled_laser",
    settings=PolledLaser,
    rest_s=0.001,
    example={"axis": "x", "dialect": "LK-G"},
    claims=frozenset({"falls silent"}),
    usual=(
        {"dialect": "LK-G"},
        {"dialect": "LK-G5000"},
        {"dialect": "HL-G1"},
        {"dialect": "IL", "baud": 9_600, "rate_Hz": 20},
        {"dialect": "LK-G", "baud": 9_600, "rate_Hz": 20},
    ),
    line=_line,
    channels=displacement_channels,
    pipeline=_pipeline,
    poller=_poller,
    far_end=_part("far_end:SimulatedPolledLaser.of"),
    played=_played,
    open=_open,
    identity_request=_part("identity:identity_turns"),
)
