"""RIFTEK RF60x sensors on Ethernet as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from daq.drivers.contract import DeviceLine, Pipeline, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser


def _line(settings: RiftekEthernetLaser) -> DeviceLine:
    """Return a UDP port, which has no rate."""
    return DeviceLine(settings.port, 0)


def _pipeline(device: str, settings: RiftekEthernetLaser, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.riftek_ethernet.stream import RiftekEthernetPipeline

    (channel,) = displacement_channels(settings)
    return RiftekEthernetPipeline(device, settings, channel, identity)


def _open(device: str, settings: RiftekEthernetLaser, talk: Talk) -> dict[str, Any]:
    """Send nothing: the sensor sends without a command, and its packets have its serial number."""
    return {"driver": "riftek_ethernet", "port": settings.port}


_part = parts_of("rig_drivers.riftek_ethernet")
DRIVER = Driver(
    name="riftek_ethernet",
    settings=RiftekEthernetLaser,
    example={"axis": "x", "rate_Hz": 9400.0},
    claims=frozenset({"counts exactly"}),
    line=_line,
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_pipeline,
    far_end=_part("far_end:SimulatedRiftekEthernet.of"),
    open=_open,
    recognise=_part("identity:recognise"),
)
