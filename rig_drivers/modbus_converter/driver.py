"""Frequency converters by Modbus RTU as a driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.drivers.played import PlayedDevice
from daq.items import DeviceEvent
from rig_drivers.modbus_converter.settings import ModbusConverter


def _line(settings: ModbusConverter) -> DeviceLine:
    return DeviceLine(settings.port, settings.baud, parity=settings.parity, stop_bits=settings.stop_bits)


def _pipeline(device: str, settings: ModbusConverter, identity: Mapping[str, Any]) -> Pipeline:
    from rig_drivers.modbus_converter.stream import ConverterPipeline

    return ConverterPipeline(device, settings)


def _words(event: DeviceEvent) -> str:
    return event.text if event.facts["error_code"] or event.facts.get("restart") else ""


def _checks(
    settings: ModbusConverter, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the converter's state, its faults, and requests that it refused."""
    from rig_drivers.modbus_converter.status_checks import converter_checks

    return converter_checks(pipeline, control, events)


def _played(settings: ModbusConverter, identity: Mapping[str, Any]) -> PlayedDevice:
    from rig_drivers.modbus_converter.played import PlayedConverter

    return PlayedConverter(settings)


def _open(device: str, settings: ModbusConverter, talk: Talk) -> dict[str, Any]:
    """Query the converter. It is polled by its command (`control`)."""
    from rig_drivers.modbus_converter.dialogue import identify

    return {"driver": "modbus_converter", **identify(device, settings, talk)}


_part = parts_of("rig_drivers.modbus_converter")
DRIVER = Driver(
    name="modbus_converter",
    settings=ModbusConverter,
    rest_s=0.005,
    example={"table": "generic"},
    claims=frozenset({"checksum", "falls silent"}),
    line=_line,
    channels=motor_channels,
    pipeline=_pipeline,
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedConverter.of"),
    played=_played,
    open=_open,
    speed_source=_part("control:ConverterControl"),
)
