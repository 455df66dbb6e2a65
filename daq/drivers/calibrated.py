"""Calibration of displacement sensors, applied where pipelines are fed: once, for every driver, live and in replay.

A driver converts what its sensor reports with range and lever. The displacement that follows is

    displacement = gain_factor × the driver's displacement + offset_m,

with both numbers from the device's table in the rig file. Bytes arrive at least `least_delay_s` after their samples;
the driver receives the time of their arrival less this delay. A log contains this table, so that its bytes are decoded
with the calibration of its own date. The raw words of the sensor (`code`) are not changed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

from daq.drivers.contract import Pipeline
from daq.items import RX, Batch, DeviceEvent
from rig_configs.device import DeviceSettings, displacement_tables

_FIELD = "displacement_m"


@dataclass(frozen=True)
class Calibration:
    """Calibration of one device.

    Attributes:
        lines: gain factor, and offset in m, by topic; without channels that need no correction.
        least_delay_ns: least delay of the device's bytes, ns.
    """

    lines: Mapping[str, tuple[float, float]]
    least_delay_ns: int

    @classmethod
    def of(cls, settings: DeviceSettings) -> Calibration:
        """Return the calibration in the settings of a device."""
        lines = {table.topic: (table.gain_factor, table.offset_m) for table in displacement_tables(settings)}
        needed = {topic: line for topic, line in lines.items() if line != (1.0, 0.0)}
        return cls(needed, round(settings.least_delay_s * 1e9))

    def decode(self, pipeline: Pipeline, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        """Feed a pipeline and return its items with the calibration applied; see `Pipeline.feed`."""
        items = pipeline.feed(direction, data, host_ns - self.least_delay_ns if direction == RX else host_ns)
        return [self._corrected(item) for item in items] if self.lines else items

    def _corrected(self, item: Batch | DeviceEvent) -> Batch | DeviceEvent:
        if not isinstance(item, Batch) or item.channel.topic not in self.lines:
            return item
        gain, offset_m = self.lines[item.channel.topic]
        return replace(item, columns={**item.columns, _FIELD: gain * item.columns[_FIELD] + offset_m})


@dataclass(frozen=True)
class CalibratedPipeline:
    """A pipeline and the calibration of its device; it is fed like the pipeline."""

    pipeline: Pipeline
    calibration: Calibration

    @property
    def losses(self) -> dict[str, int]:
        """Number of losses so far, by kind; see Pipeline."""
        return self.pipeline.losses

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        """Decode the bytes of one read or write; see Pipeline."""
        return self.calibration.decode(self.pipeline, direction, data, host_ns)


def calibrations_of(devices: Mapping[str, DeviceSettings]) -> dict[str, str]:
    """Return the facts of a log about the calibrations of its devices: one JSON text; empty if there is none."""
    known = {
        name: {"calibrated": device.calibrated, "record": device.calibration_record}
        for name, device in devices.items()
        if device.calibrated
    }
    return {"calibrations": json.dumps(known)} if known else {}
