"""RF60x sensors as a driver."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from daq.drivers.contract import DeviceLine, Pipeline, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from rig_drivers.riftek.settings import RiftekLaser


def _line(settings: RiftekLaser) -> DeviceLine:
    return DeviceLine(settings.port, settings.baud, parity=settings.parity)


def _pipeline(device: str, settings: RiftekLaser, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.riftek.stream import RiftekPipeline

    (channel,) = displacement_channels(settings)
    return RiftekPipeline(device, settings, channel, identity)


def _compile() -> None:
    import numpy as np

    from daq.drivers.spikes import compile_watch
    from rig_drivers.riftek import wire
    from rig_drivers.riftek.decoder import ResultDecoder

    compile_watch()
    ResultDecoder().feed(wire.results(np.zeros(8, np.int64), np.arange(8)))


def _stop(settings: RiftekLaser, talk: Talk) -> None:
    from rig_drivers.riftek.dialogue import stop

    stop(talk)


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
    line=_line,
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_pipeline,
    far_end=_part("far_end:SimulatedRiftek.of"),
    played=_part("played:PlayedRiftek"),
    compile=_compile,
    open=_part("dialogue:configure"),
    stop=_stop,
    identity_request=_part("identity:identity_turns"),
)
