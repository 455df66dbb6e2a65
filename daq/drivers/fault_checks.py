"""Checks of a speed source that do not use its speed: its state, and the faults it reported."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl
from daq.drivers.host_command import UNKNOWN
from daq.items import DeviceEvent


def controller_checks(
    control: SpeedControl | None,
    events: Sequence[DeviceEvent],
    words: Callable[[int], str],
    faulty: Collection[str],
    harmless: Collection[int] = (),
) -> Checks:
    """Return the checks of an open device that turns the rotor.

    Args:
        control: command of the device; None if its bytes are only received.
        events: events of the device during the check.
        words: returns the meaning of a fault code.
        faulty: states of a device that cannot be used.
        harmless: codes of faults that are reset by the next `SpeedControl.enable`.
    """
    out: Checks = {}
    if control is not None:
        state = control.state
        code = control.fault_code() if state in faulty and state != UNKNOWN else None
        note = words(code) if code else "it reports no cause" if state == "FAULT" else ""
        out["state"] = DeviceCheck(state, "no fault", state not in faulty or code in harmless, note)
    troubles = {
        words(code) if code else event.text: code
        for event in events
        if event.kind == "emergency" and ((code := int(event.facts.get("error_code", 0))) or event.facts.get("restart"))
    }
    passed = all(code in harmless for code in troubles.values())
    out["emergencies"] = DeviceCheck(", ".join(troubles) or "none", "none", passed)
    return out
