"""Checks of a converter that do not use its speed: its state, its faults, and the requests that it refused."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import Pipeline, SpeedControl
from daq.drivers.fault_checks import controller_checks
from daq.items import DeviceEvent
from rig_drivers.modbus_converter import states
from rig_drivers.modbus_converter.settings import ModbusConverter
from rig_drivers.modbus_converter.stream import ConverterPipeline


def converter_checks(
    settings: ModbusConverter, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the checks of an open converter.

    Args:
        settings: table of the converter in the rig file.
        pipeline: pipeline of the converter.
        control: command of the converter; None if its bytes are only received.
        events: events of the converter during the check.
    """
    out = controller_checks(control, events, states.fault_text, (states.FAULT, states.UNKNOWN))
    refused = [event.text for event in events if event.kind == "refused"]
    note = "compare the register table with its manual" if refused else ""
    out["refused_requests"] = DeviceCheck(len(refused), 0, not refused, note)
    if isinstance(pipeline, ConverterPipeline) and pipeline.echoes:
        note = "the adapter returns the host's own bytes; they are dropped. Switch the echo off if the adapter can"
        out["echo"] = DeviceCheck("yes", "no or yes", True, note)
    return out
