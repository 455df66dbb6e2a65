"""Checks of a motor controller that do not use its speed: its state, and the faults it reported."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl
from daq.items import DeviceEvent


def controller_checks(
    control: SpeedControl | None, events: Sequence[DeviceEvent], words: Callable[[int], str], faulty: Collection[str]
) -> Checks:
    """Return the checks of an open controller.

    Args:
        control: command of the controller; None if its bytes are only received.
        events: events of the controller during the check.
        words: returns the meaning of a fault code.
        faulty: states of a controller that cannot be used.
    """
    out: Checks = {}
    if control is not None:
        state, code = control.state, control.fault_code()
        out["state"] = DeviceCheck(state, "no fault", state not in faulty, words(code) if code else "")
    codes = [int(e.facts.get("error_code", 0)) for e in events if e.kind == "emergency"]
    bad = [code for code in codes if code]
    out["emergencies"] = DeviceCheck(", ".join(words(code) for code in bad) or "none", "none", not bad, "")
    return out
