"""Output of `rig virtual`: the faults that can be placed, and the visible state of the rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig_cli.console import show


def show_faults(kinds: Mapping[str, Mapping[str, Any]]) -> None:
    """Print each device's faults, a line each; those that every device can have are listed once, at the end."""
    lines = {device: [_line(fault) for fault in each.items()] for device, each in kinds.items()}
    shared = [line for line in next(iter(lines.values())) if all(line in each for each in lines.values())]
    for device, each in lines.items():
        show(f"{device}:")
        for line in each:
            if line not in shared or len(lines) == 1:
                show(line)
    show("any device:" if len(lines) > 1 else "")
    for line in shared if len(lines) > 1 else []:
        show(line)
    show("(once): it cannot be ended; all others end with --end, or by themselves after --seconds")


def _line(fault: tuple[str, Mapping[str, Any]]) -> str:
    what, facts = fault
    low, high = facts["limits"]
    value = f" [--value: {facts['meaning']}, {low:g} to {high:g}; else {facts['value']:g}]" if facts["meaning"] else ""
    return f"  {what.replace(' ', '-'):16} {facts['words']}{value}{'' if facts['lasts'] else ' (once)'}"


def onlooker(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state without duplicates, and with lists of frames replaced by their number."""
    own = {"time_s", "speed_rpm", "displacement_mm", "pendulums_deg", "pendulums_held"}
    devices = {
        name: {
            **each,
            "facts": {key: len(fact) if key == "dropped" else fact for key, fact in each["facts"].items()},
            "overrun_bytes": state["overrun_bytes"][name],
        }
        for name, each in state["devices"].items()
    }
    return {**{key: state[key] for key in sorted(own)}, "devices": devices}


def show_state(seen: Mapping[str, Any]) -> None:
    """Print the visible state of the rig."""
    x, y = seen["displacement_mm"]
    a, b = (
        f"{'held' if held else 'free'} at {deg % 360:.1f}°"
        for deg, held in zip(seen["pendulums_deg"], seen["pendulums_held"], strict=True)
    )
    show(f"{seen['time_s']:.1f} s, {seen['speed_rpm']:.1f} rpm, column at {x:+.2f} and {y:+.2f} mm")
    show(f"pendulum A {a}, B {b}")
    for name, device in seen["devices"].items():
        faults = ", ".join(f"{what} ({value:g})" for what, value in device["faults"].items())
        place = device["port"] if device["plugged"] else "unplugged"
        show(f"  {name:12} {place}{f'   faults: {faults}' if faults else ''}")
