"""optoNCDT sensors as a driver."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.optoncdt import distance_words
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.plain import displacement_channels, displacement_clocks
from daq.items import DeviceEvent
from rig_basics.texts import number_of


def _checks(settings: Laser, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the meaning of the error codes in place of distances, if there were any."""
    if not pipeline.error_codes:
        return {}
    code, count = max(pipeline.error_codes.items(), key=lambda found: found[1])
    meaning = _code_meaning(code) or "not in the manuals"
    remedy = distance_words.REMEDIES.get(code)
    note = f"in {number_of(count, 'sample')}" + (f": {remedy}" if remedy else "")
    return {"error_code": DeviceCheck(f"{code}: {meaning}", None, True, note)}


def _code_meaning(code: int) -> str:
    return distance_words.ERROR_CODES.get(code, "")


def _stop(settings: Laser, talk: Talk) -> None:
    talk.send(b"OUTPUT NONE\n")


_part = parts_of("daq.drivers.optoncdt")
DRIVER = Driver(
    name="optoncdt",
    settings=Laser,
    example={"axis": "x"},
    claims=frozenset({"counts exactly", "falls silent"}),
    usual=({}, *({"baud": baud} for baud in (691_200, 115_200, 230_400, 460_800, 1_000_000))),
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**18),
    pipeline=_part("stream:LaserPipeline"),
    far_end=_part("far_end:SimulatedLaser.of"),
    played=_part("far_end:PlayedLaser"),
    checks=_checks,
    code_meaning=_code_meaning,
    open=_part("dialogue:configure"),
    stop=_stop,
    identity_request=_part("dialogue:identity_turns"),
)
