"""optoNCDT 2300 sensors on Ethernet as a driver."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from daq.items import DeviceEvent
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser


def _checks(
    settings: EthernetLaser, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the values that the flags of the packets name, and the reason why samples are not taken."""
    expected = ", ".join(settings.words)
    doubt, complaint = str(pipeline.doubt), pipeline.status.complaint
    return {
        "values": DeviceCheck("others" if doubt else expected, expected, not doubt, doubt),
        "packets": DeviceCheck("differ" if complaint else "fit", "fit", not complaint, complaint),
    }


_part = parts_of("rig_drivers.optoncdt_ethernet")
DRIVER = Driver(
    name="optoncdt_ethernet",
    settings=EthernetLaser,
    example={"axis": "x"},
    claims=frozenset({"counts exactly"}),
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_part("stream:EthernetPipeline"),
    far_end=_part("far_end:SimulatedEthernetLaser.of"),
    checks=_checks,
    recognise=_part("stream:recognise"),
)
