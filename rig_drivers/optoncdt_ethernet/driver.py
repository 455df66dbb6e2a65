"""optoNCDT 2300 sensors on Ethernet as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import DeviceLine, Pipeline, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import displacement_channels, displacement_clocks
from daq.items import DeviceEvent
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser


def _line(settings: EthernetLaser) -> DeviceLine:
    """Return a TCP connection, which has no rate."""
    return DeviceLine(settings.port, 0)


def _pipeline(device: str, settings: EthernetLaser, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.optoncdt_ethernet.stream import EthernetPipeline

    (channel,) = displacement_channels(settings)
    return EthernetPipeline(device, settings, channel, identity)


def _checks(
    settings: EthernetLaser, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the values that the flags of the packets name, and the reason why samples are not taken."""
    expected = ", ".join(settings.words)
    doubt, complaint = str(pipeline.doubt), str(pipeline.complaint)
    return {
        "values": DeviceCheck("others" if doubt else expected, expected, not doubt, doubt),
        "packets": DeviceCheck("differ" if complaint else "fit", "fit", not complaint, complaint),
    }


def _open(device: str, settings: EthernetLaser, talk: Talk) -> dict[str, Any]:
    """Send nothing: the sensor sends as soon as it is connected, and its packets have its serial number."""
    return {"driver": "optoncdt_ethernet", "port": settings.port}


_part = parts_of("rig_drivers.optoncdt_ethernet")
DRIVER = Driver(
    name="optoncdt_ethernet",
    settings=EthernetLaser,
    example={"axis": "x"},
    claims=frozenset({"counts exactly"}),
    line=_line,
    channels=displacement_channels,
    clocks=partial(displacement_clocks, 2**32),
    pipeline=_pipeline,
    far_end=_part("far_end:SimulatedEthernetLaser.of"),
    checks=_checks,
    open=_open,
    recognise=_part("identity:recognise"),
)
