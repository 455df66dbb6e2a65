"""Calibration of displacement sensors, applied where pipelines are made: once, for every driver, live and in replay.

A driver converts what its sensor reports with range and lever. The displacement that follows is

    displacement = gain_factor × the driver's displacement + offset_m,

with both numbers from the device's table in the rig file. Bytes arrive at least `least_delay_s` after their samples;
the driver receives the time of their arrival less this delay. A log contains this table, so that its bytes are decoded
with the calibration of its own date. The raw words of the sensor (`code`) are not changed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from daq.drivers.contract import Pipeline
from daq.items import RX, Batch, DeviceEvent
from rig_configs.device import DeviceSettings, displacement_tables

_FIELD = "displacement_m"


def calibrated(pipeline: Pipeline, settings: DeviceSettings) -> Pipeline:
    """Return the pipeline with the calibration of its settings applied to its displacements.

    The same object is returned, since drivers read the attributes of their own pipelines. Without a calibration (factor
    1, offset 0, least delay 0) it is not changed.
    """
    lines = {table.topic: (table.gain_factor, table.offset_m) for table in displacement_tables(settings)}
    lines = {topic: line for topic, line in lines.items() if line != (1.0, 0.0)}
    delay_ns = round(settings.least_delay_s * 1e9)
    if not lines and not delay_ns:
        return pipeline
    decode = pipeline.feed

    def corrected(item: Batch | DeviceEvent) -> Batch | DeviceEvent:
        if not isinstance(item, Batch) or item.channel.topic not in lines:
            return item
        gain, offset_m = lines[item.channel.topic]
        return replace(item, columns={**item.columns, _FIELD: gain * item.columns[_FIELD] + offset_m})

    def feed(direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        sent_ns = host_ns - delay_ns if direction == RX else host_ns
        return [corrected(item) for item in decode(direction, data, sent_ns)]

    pipeline.feed = feed
    return pipeline


def calibrations_of(devices: Mapping[str, DeviceSettings]) -> dict[str, str]:
    """Return the facts of a log about the calibrations of its devices: one JSON text; empty if there is none."""
    known = {
        name: {"calibrated": device.calibrated, "record": device.calibration_record}
        for name, device in devices.items()
        if device.calibrated
    }
    return {"calibrations": json.dumps(known)} if known else {}
