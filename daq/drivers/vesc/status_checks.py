"""Checks of a VESC that do not use its speed: its state, and the faults it reported."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl
from daq.drivers.vesc import wire
from daq.items import DeviceEvent

_FAULTY = ("FAULT", "KILL SWITCH OPEN", "UNKNOWN")


def controller_checks(control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    """Return the checks of an open controller.

    Args:
        control: command of the controller; None if its bytes are only received.
        events: events of the controller during the check.
    """
    out: Checks = {}
    if control is not None:
        state, code = control.state, control.fault_code()
        note = "" if not code else wire.fault_words(code)
        out["state"] = DeviceCheck(state, "no fault", state not in _FAULTY, note)
    codes = [int(e.facts.get("error_code", 0)) for e in events if e.kind == "emergency"]
    bad = [code for code in codes if code]
    words = ", ".join(wire.fault_words(code) for code in bad) or "none"
    out["emergencies"] = DeviceCheck(words, "none", not bad, "")
    return out
