"""Checks of a RotorLink node that do not use its samples: its status and its radio."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.checks import Checks, DeviceCheck, signal_check
from daq.drivers.contract import Pipeline, SpeedControl
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import DeviceEvent
from rig_configs.device import RotorNodeSettings


def node_checks(
    settings: RotorNodeSettings, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the checks of the node's newest status and signal strength; see Driver.checks."""
    assert isinstance(pipeline, NodePipeline)
    status = pipeline.node_status
    out: Checks = {}
    if status is None:
        out["status"] = DeviceCheck(None, "each second", False, "the node's status did not arrive; look at its radio")
    else:
        counts = settings.counts_per_revolution
        ok = status.counts_per_revolution == counts
        note = "" if ok else "every angle would be scaled wrongly: correct the rig file"
        out["counts_per_revolution"] = DeviceCheck(status.counts_per_revolution, counts, ok, note)
        low = pipeline.battery_low
        note = "the node reports that it is low: change it" if low else ""
        out["battery_mV"] = DeviceCheck(status.battery_mv, "not low", not low, note)
        out["firmware"] = DeviceCheck(f"{status.firmware_major}.{status.firmware_minor}", None, True)
        out["temperature_degC"] = DeviceCheck(status.temperature_decidegc / 10, None, True)
        out["overruns"] = DeviceCheck(
            status.overruns, None, True, "" if not status.overruns else "samples lost in the node"
        )
    return out | signal_check(pipeline.rssi_dBm, -90, "move the dongle nearer")
