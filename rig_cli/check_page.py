"""Measurements for `rig check` from an open session, and their table."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from daq.acquisition.device_check import Checks, ObservedAngles, ObservedSpeed, RigObservation, passed
from daq.acquisition.session import Session
from daq.drivers.checks import DeviceCheck
from daq.items import DeviceEvent
from rig_cli.words import printable, stdout_console
from rig_configs.roles import PendulumAngles, Roles

_LOCKED_S = 0.1  # duration of the newest pendulum angles that are checked
_STATUS_WAIT_S = 3.0  # devices that report their status do so each second; longest wait for one report, rig time


def look_at(session: Session, seconds: float) -> RigObservation:
    """Observe an open rig for `seconds` of wall time, longer only for the devices' status reports, one each second."""
    events: list[DeviceEvent] = []
    session.device_event_observers.append(events.append)
    before, started = session.losses(), session.clock.now_ns()
    time.sleep(seconds)
    wait = session.clock.now_ns() + int(_STATUS_WAIT_S * 1e9)
    while not session.all_identified() and session.clock.now_ns() < wait:
        session.clock.sleep(0.1)
    session.device_event_observers.remove(events.append)
    roles, plain = session.rig.roles, plain_rates(session, started)
    speed = roles.speed and ObservedSpeed(plain[roles.speed.topic], session.drive.actual_rpm)
    return RigObservation(
        seconds=(session.clock.now_ns() - started) * 1e-9,
        rates=session.rates.rates(),
        losses={name: _more(lost, before[name]) for name, lost in session.losses().items()},
        events=events,
        displacement_m={
            sensor.axis: session.recent.last(sensor.topic, ("displacement_m",), started)[1][0]
            for sensor in roles.displacements
        },
        angles=roles.angles and _angles(session, roles.angles, started),
        speed=speed,
        own=_with_duties(session.own_checks(events), roles),
    )


def _with_duties(own: Mapping[str, Checks], roles: Roles) -> dict[str, Checks]:
    """Return the checks of the devices' drivers, with what each displacement sensor measures for the rig."""
    out = {name: dict(checks) for name, checks in own.items()}
    for device, words in roles.duties.items():
        out.setdefault(device, {})["measures"] = DeviceCheck(words, None, True)
    return out


def _angles(session: Session, role: PendulumAngles, started_ns: int) -> ObservedAngles:
    _, (a, b, flags) = session.recent.last(role.topic, ("theta3_rad", "theta4_rad", "flags"), started_ns)
    return ObservedAngles(np.column_stack([a, b])[-max(1, round(_LOCKED_S * role.rate_Hz)) :], flags)


def _more(now: Mapping[str, int], before: Mapping[str, int]) -> dict[str, int]:
    return {kind: count - before.get(kind, 0) for kind, count in now.items()}


def plain_rates(session: Session, started_ns: int) -> dict[str, float]:
    """Return the samples per second of every channel since an instant, without lost ones."""
    rates: dict[str, float] = {}
    for topic in session.topics:
        times, _ = session.recent.last(topic, (), started_ns)
        span = float(times[-1] - times[0]) * 1e-9 if len(times) > 1 else 0.0
        rates[topic] = (len(times) - 1) / span if span > 0 else math.nan
    return rates


def print_checks(devices: Mapping[str, Checks], identities: Mapping[str, Mapping[str, Any]], seconds: float) -> None:
    """Print the table on standard output, with the reason next to a failed check."""
    console = stdout_console()
    for name, checks in devices.items():
        verdict = Text("pass", "bold green") if passed(checks) else Text("FAIL", "bold red")
        known = ", ".join(f"{key} {value}" for key, value in identities.get(name, {}).items())
        console.print(Text.assemble((name, "bold"), "  ", verdict, "  ", (printable(known), "dim")), soft_wrap=True)
        table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2))
        for check, found in checks.items():
            style = "" if found.passed else "bold red"
            mark = Text("✓", "green") if found.passed else Text("✗", "bold red")
            value = "—" if found.value is None else printable(found.value)
            expected = "" if found.expected is None else f"expected {printable(found.expected)}"
            table.add_row(mark, check, Text(value, style), Text(expected, "dim"), Text(printable(found.note), style))
        console.print(table)
    console.print(Text(f"looked for {seconds:.1f} s", "dim"))
