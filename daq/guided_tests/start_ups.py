"""Start-ups: repeated spin-ups and releases, each in its own log, with a classification of the steady states.

With `from_rest` the pendulums (or balls, which have no locks) are released before the rotor turns, as in a machine in
use, and start from different angles.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from daq.guided_test_kinds import GuidedTestRequest, Number, TestKind
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.frame import RELEASE_AT_REST, framed, spin_up
from daq.guided_tests.point import SPEED, point_states, refusal, settle_state
from daq.guided_tests.table import MOTION, State, StateTable, after, not_missed
from daq.signals.settling import Settling
from daq.signals.state_type import state_type
from rig_configs.schema import Rig

_MIN_SLIPPING_S = 30.0  # slipping for this time after the release counts as permanent, s
_CLASSES = {"I": "balanced"}
_BEFORE_S = 1.0  # pendulums at their locks at the start of the log, s
_SCATTERED_S = 2.0  # wait after the pendulums were scattered, s


def _classify(rig: Rig, commands: RigCommands) -> None:
    """Write the class of the start-up to the facts: "balanced", "slipping" or "other", and the settled values."""
    last: Settling | None = commands.memory.get("last")
    state, facts = "not settled", dict[str, Any]()
    if last is not None and last.settled:
        a, b = commands.measures.mean_angles_rad()
        x, y = commands.measures.amplitudes_m()
        state = state_type((a, b), rig.physics)
        facts = {"theta3_deg": math.degrees(a) % 360, "theta4_deg": math.degrees(b) % 360}
        facts |= {"amplitude_x_mm": 1e3 * x, "amplitude_y_mm": 1e3 * y}
    elif last is not None and last.slipping:
        state = "slipping"
    kind = state if state == "slipping" else _CLASSES.get(state, "other")
    commands.facts.update({"class": kind, "state": state, **facts})


def _from_rest(request: GuidedTestRequest, rpm: float) -> tuple[State, ...]:
    """Return the states from the release at rest to the steady state."""
    return (
        State(
            "begin",
            does="begin the log",
            enter=RigCommands.begin,
            waits_for=f"{_BEFORE_S:g} s at the locks",
            look=after(_BEFORE_S, "the pendulums at their locks"),
            period_s=0.1,
            usual_s=_BEFORE_S,
            limit_s=60.0,
        ),
        RELEASE_AT_REST,
        State(
            "scatter",
            does="request arbitrary angles of both pendulums",
            enter=lambda commands: commands.operator.scatter(),
            actor="operator",
            asks="bring both pendulums or balls to arbitrary angles, different each time",
            waits_for=f"{_SCATTERED_S:g} s",
            look=after(_SCATTERED_S),
            period_s=0.1,
            usual_s=_SCATTERED_S,
            limit_s=60.0,
        ),
        *(replace(state, no_pause=state.no_pause or MOTION) for state in spin_up(request, rpm, free=True)),
        settle_state(request, rpm, _MIN_SLIPPING_S, free=True),
    )


def _table(request: GuidedTestRequest) -> StateTable:
    rpm = request.numbers["speed_rpm"]
    states = _from_rest(request, rpm) if request.numbers["from_rest"] else point_states(request, rpm, _MIN_SLIPPING_S)
    classify = partial(_classify, request.rig)
    classed = State("class", does="classify the steady state: balanced, slipping or other", enter=classify)
    *before, settle = states
    settle = replace(settle, missed=not_missed, late=classed.name)
    return framed(request, *before, settle, classed, releases=True)


def summed(runs: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the number of start-ups by class and by state, and mean and range of the quantities of each state.

    Args:
        runs: summaries of the logs. Aborted runs lack `class` and are not counted.
    """
    classed = [run for run in runs if "class" in run]
    counts = Counter(str(run["class"]) for run in classed)
    states = Counter(str(run["state"]) for run in classed)
    return {
        "start_ups": len(classed),
        "classes": {name: counts[name] for name in ("balanced", "slipping", "other")},
        "states": dict(states),
        "measured": {state: _ranges([run for run in classed if run["state"] == state]) for state in sorted(states)},
    }


def _ranges(runs: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return mean, minimum and maximum of each quantity; angles in degrees, relative to their mean direction."""
    found: dict[str, Any] = {}
    for key in ("theta3_deg", "theta4_deg", "amplitude_x_mm", "amplitude_y_mm"):
        values = [float(run[key]) for run in runs if key in run]
        if not values:
            continue
        middle = _mean_direction_deg(values) if key.endswith("_deg") else sum(values) / len(values)
        off = [(v - middle + 180) % 360 - 180 if key.endswith("_deg") else v - middle for v in values]
        mean = middle + sum(off) / len(off)
        found[key] = {"mean": mean, "least": middle + min(off), "largest": middle + max(off)}
    return found


def _mean_direction_deg(degrees: Sequence[float]) -> float:
    turned = [math.radians(v) for v in degrees]
    return math.degrees(math.atan2(sum(map(math.sin, turned)), sum(map(math.cos, turned)))) % 360


KIND = TestKind(
    "start-ups",
    "spin up and release repeatedly, or release and spin up; classify every steady state",
    ("x", "y", "angles", "phase"),
    turns=True,
    table=_table,
    point="optional",
    numbers={
        **SPEED,
        "count": Number("number of start-ups", 20, 1, 10_000, whole=True),
        "from_rest": Number("1: pendulums free before the rotor turns, 0: released at speed", 0, 0, 1, whole=True),
    },
    refusal=refusal,
    combined=summed,
)
