"""Checks of a CiA 402 drive that do not use its speed: its state, its emergencies, and the host's heartbeat."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.canopen import cia301
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.cia402 import wire
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.faults import REMEDY, is_decimal_error
from daq.drivers.cia402.host_beats import IN_A_ROW
from daq.drivers.contract import SpeedControl
from daq.drivers.fault_checks import controller_checks
from daq.items import DeviceEvent

_FAULTY = (wire.FAULT, wire.FAULT_REACTION, wire.UNKNOWN)


def drive_checks(control: SpeedControl | None, events: Sequence[DeviceEvent], foreign_beats: int = 0) -> Checks:
    """Return the checks of an open drive.

    Args:
        control: command of the drive; None if its bytes are only received.
        events: events of the drive during the check.
        foreign_beats: number of heartbeats under the host's number that the host did not send.
    """
    out = controller_checks(control, events, _meaning, _FAULTY, (cia301.HEARTBEAT_ERROR,))
    note = "" if foreign_beats < IN_A_ROW else "another node bears the host's number (host_node_id): find it"
    out["foreign_heartbeats"] = DeviceCheck(foreign_beats, 0, foreign_beats < IN_A_ROW, note)
    if isinstance(control, DriveControl):
        out |= _reaction(control) | _unit(control)
    return out


def _reaction(control: DriveControl) -> Checks:
    """Return the check of the reaction to a missing host, if the drive states that it does nothing."""
    if not control.ignores_missing_host():
        return {}
    note = "it would go on turning without its host: set 6007h to 1 (fault) or 3 (quick stop) with its maker's tool"
    return {"reaction": DeviceCheck("none (6007h is 0)", "a stop", False, note)}


def _unit(control: DriveControl) -> Checks:
    """Return the check of the unit of speed, if the drive states it. A ratio other than a power of ten is a gear's."""
    units = control.units_per_rpm()
    if units is None:
        return {}
    given, stated = units
    ok = not is_decimal_error(stated, given)
    note = "" if ok else "its unit (60A9h) is another one, so every speed is scaled: correct units_per_rpm"
    return {"units_per_rpm": DeviceCheck(given, stated, ok, note)}


def _meaning(code: int) -> str:
    remedy = ": a host was gone; the next test resets it" if code == cia301.HEARTBEAT_ERROR else f". {REMEDY}"
    return f"{cia301.emergency_words(code)}{remedy}"
