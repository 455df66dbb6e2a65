"""RF60x sensors as a driver."""

from __future__ import annotations

from functools import partial

from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from rig_drivers.riftek.settings import RiftekLaser

_part = parts_of("rig_drivers.riftek")
DRIVER = Driver(
    name="riftek",
    settings=RiftekLaser,
    example={"axis": "x"},
    claims=frozenset({"falls silent"}),
    usual=(
        {},
        {"baud": 9_600, "rate_Hz": 200},
        {"baud": 460_800},
        {"baud": 115_200, "rate_Hz": 2000},
    ),
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_part("stream:RiftekPipeline"),
    far_end=_part("far_end:SimulatedRiftek.of"),
    played=_part("far_end:PlayedRiftek"),
    open=_part("dialogue:configure"),
    stop=_part("dialogue:stop"),
    identity_request=_part("dialogue:identity_turns"),
)
