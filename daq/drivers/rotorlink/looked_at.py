# pyright: strict
"""What a short look shows of a RotorLink node beside its samples: its own word of itself, its radio."""

from __future__ import annotations

from daq.drivers.checks import Check, Checks
from daq.drivers.contract import Pipeline
from daq.drivers.rotorlink.stream import NodePipeline
from rig_configs.device import RotorNodeSettings

_WEAK_DBM = -90


def node_checks(settings: RotorNodeSettings, pipeline: Pipeline) -> Checks:
    """Checks of the node's newest status and signal."""
    assert isinstance(pipeline, NodePipeline)
    status, rssi_dBm = pipeline.status, pipeline.rssi_dBm
    out: Checks = {}
    if status is None:
        out["status"] = Check(None, "each second", False, "the node's own word did not come; look at its radio")
    else:
        counts = settings.counts_per_revolution
        ok = status.counts_per_revolution == counts
        note = "" if ok else "every angle would be scaled wrongly: correct the rig file"
        out["counts_per_revolution"] = Check(status.counts_per_revolution, counts, ok, note)
        low = pipeline.battery_low
        note = "the node says it is low: change it" if low else ""
        out["battery_mV"] = Check(status.battery_mv, "not low", not low, note)
        out["firmware"] = Check(f"{status.firmware_major}.{status.firmware_minor}", None, True)
        out["temperature_degC"] = Check(status.temperature_decidegc / 10, None, True)
        out["overruns"] = Check(status.overruns, None, True, "" if not status.overruns else "samples lost in the node")
    if rssi_dBm is not None:
        weak = rssi_dBm < _WEAK_DBM
        note = "weak: move the dongle nearer" if weak else ""
        out["signal_dBm"] = Check(rssi_dBm, f"at least {_WEAK_DBM}", not weak, note)
    return out
