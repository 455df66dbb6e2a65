"""RIFTEK RF60x sensors on Ethernet as a driver."""

from __future__ import annotations

from functools import partial

from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser

_part = parts_of("rig_drivers.riftek_ethernet")
DRIVER = Driver(
    name="riftek_ethernet",
    settings=RiftekEthernetLaser,
    example={"axis": "x", "rate_Hz": 9400.0},
    claims=frozenset({"counts exactly"}),
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_part("stream:RiftekEthernetPipeline"),
    far_end=_part("far_end:SimulatedRiftekEthernet.of"),
    recognise=_part("identity:recognise"),
)
