"""Frequency converters by Modbus RTU as a driver."""

from __future__ import annotations

from daq.drivers.driver import Driver, parts_of
from daq.drivers.plain import motor_channels
from daq.items import DeviceEvent
from rig_drivers.modbus_converter.settings import ModbusConverter


def _words(event: DeviceEvent) -> str:
    return event.text if event.facts["error_code"] or event.facts.get("restart") else ""


_part = parts_of("rig_drivers.modbus_converter")
DRIVER = Driver(
    name="modbus_converter",
    settings=ModbusConverter,
    pause_s=0.005,
    example={"table": "generic"},
    claims=frozenset({"checksum", "falls silent"}),
    channels=motor_channels,
    pipeline=_part("stream:ConverterPipeline"),
    words=_words,
    checks=_part("stream:converter_checks"),
    far_end=_part("far_end:SimulatedConverter.of"),
    played=_part("far_end:PlayedConverter"),
    open=_part("dialogue:identify"),
    speed_source=_part("control:ConverterControl"),
)
