"""A point: spin up with locked pendulums, wait for a steady orbit, release, record until all is steady."""

from __future__ import annotations

import math
from typing import Any

from daq.guided_test_kinds import GuidedTestRequest, Number, TestKind
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.frame import framed, near_resonance, spin_up
from daq.guided_tests.table import MOTION, State, StateObservation, StateTable, StateView, after
from daq.guided_tests.test_inputs import speed_refusal
from daq.signals.settling import WINDOW_S, Settling, SettlingLimits
from rig_basics.units import RPM
from rig_configs.schema import Rig

_POINT_LIMIT_S = 90.0
_EXTENSION_S = 60.0  # beyond that limit, while the remaining change is bounded and predicted to end within this time
_DOUBT_S = 5.0  # the extension outlasts looks that contradict it, such as after a correction of a device's clock
_MAX_LOCKED_STEADY_S = 60.0  # wait for a steady orbit before the release, s
# Stricter than the second look and the analysis, so that a steady state here is one in the log too.
_FIRST_LIMITS = SettlingLimits(angle_tolerance_rad=math.radians(0.05), amplitude_tolerance_m=2e-6)
_SECOND_LIMITS = SettlingLimits()
_BEFORE_RELEASE_S = 4.0
_AFTER_RELEASE_S = 3.0  # after the release before the first look, s
_AFTER_STEADY_S = 2.5  # steady state in the log before the second look with the tolerances of the analysis, s


def point_states(request: GuidedTestRequest, rpm: float, slips_s: float = math.inf) -> tuple[State, ...]:
    """Return the states from the spin-up to the steady state after a release.

    Args:
        request: the requested test.
        rpm: the speed.
        slips_s: time since the release after which a slip ends the wait, s.
    """
    waiting = near_resonance(request.rig, rpm)

    def orbit_steady(view: StateView) -> StateObservation:
        found = view.measures.locked_steady()
        facts = {"steady_before_release": found.settled}
        return StateObservation(found.settled, f"waiting for a steady orbit, {found.why}", facts=facts)

    return (
        *spin_up(request, rpm),
        State(
            "steady orbit",
            waits_for="an orbit of steady amplitude",
            look=orbit_steady,
            period_s=WINDOW_S,
            rpm=rpm,
            usual_s=12.0,
            limit_s=_MAX_LOCKED_STEADY_S,
            late="before the release",
            no_pause=waiting,
            late_warning=f"the orbit was not steady {_MAX_LOCKED_STEADY_S:g} s after the spin-up; the release follows",
        ),
        State(
            "before the release",
            does="begin the log",
            enter=RigCommands.begin,
            waits_for=f"{_BEFORE_RELEASE_S:g} s of the locked orbit",
            look=after(_BEFORE_RELEASE_S),
            rpm=rpm,
            usual_s=_BEFORE_RELEASE_S,
            limit_s=60.0,
            period_s=0.1,
            no_pause=waiting,
        ),
        State(
            "release",
            does="release both pendulums",
            enter=lambda commands: commands.release(turning=True),
            actor="locks",
            asks="release both pendulums at the same time",
            rpm=rpm,
            usual_s=0.3,
            no_pause=MOTION,
        ),
        settle_state(request, rpm, slips_s),
    )


def settle_state(request: GuidedTestRequest, rpm: float, slips_s: float, free: bool = False) -> State:
    """Return the state that waits for the steady state after a release, or with `free` after reaching the speed.

    Args:
        slips_s: time after which a slip ends the wait, s.
    """
    angles = request.rig.roles.angles
    step_rad = math.nan if angles is None else angles.step_rad
    begun = "at speed" if free else "after release"

    def all_steady(view: StateView) -> StateObservation:
        since_ns = view.entered_ns if free else int(view.memory["released_ns"])
        since = (view.now_ns - since_ns) * 1e-9
        steady_ns = view.memory.get("steady_ns")
        if since < _AFTER_RELEASE_S or (steady_ns and view.now_ns < steady_ns + _AFTER_STEADY_S * 1e9):
            return StateObservation(False, f"{since:.0f} s {begun}", near=steady_ns is not None)
        again = steady_ns is not None
        last = view.measures.steady(since_ns, step_rad, _SECOND_LIMITS if again else _FIRST_LIMITS, free)
        over = (again and last.settled) or (last.slipping and since > slips_s)
        near = last.settled or (last.approaching and since + last.more_s < _POINT_LIMIT_S + _EXTENSION_S)
        near_ns = view.now_ns if near else view.memory.get("near_ns")
        near = near_ns is not None and view.now_ns < near_ns + _DOUBT_S * 1e9
        seen: dict[str, Any] = {"last": last, "steady_ns": view.now_ns if last.settled and not again else None}
        seen["near_ns"] = near_ns
        facts = {"settled": over and last.settled, "why": last.why}
        return StateObservation(over, f"{since:.0f} s {begun}, {last.why}", store=seen, facts=facts, near=near)

    return State(
        "settle",
        waits_for="pendulums and orbit to be steady, and a second look",
        look=all_steady,
        period_s=WINDOW_S,
        rpm=rpm,
        usual_s=30.0,
        limit_s=_POINT_LIMIT_S + _AFTER_STEADY_S,
        extension_s=0.0 if free else _EXTENSION_S,
        missed=lambda view: _not_steady(request, view),
        no_pause=MOTION,
    )


def _not_steady(request: GuidedTestRequest, view: StateView) -> str:
    """Return what a point has not reached at its time limit; empty if it slips as expected."""
    last: Settling | None = view.memory.get("last")
    point = request.rig.points.get(request.point)
    if last is not None and last.slipping and point is not None and point.expected == "slipping":
        return ""
    waited_s = max(_POINT_LIMIT_S, view.in_state_s - _AFTER_STEADY_S)
    return f"the steady state within {waited_s:.0f} s of the release: {last.why if last else 'no data'}"


def _table(request: GuidedTestRequest) -> StateTable:
    return framed(request, *point_states(request, request.numbers["speed_rpm"]), releases=True)


def point_speed_rpm(rig: Rig, point: str) -> float | None:
    """Return the speed of a rig's point, rpm, from its (identified) k1; None if the rig has no such point."""
    return rig.physics.speed_rad_s(rig.points[point].speed_ratio) / RPM if point in rig.points else None


def refusal(request: GuidedTestRequest) -> str:
    """Return the reason why the speed of a requested point is refused; empty if it is accepted."""
    return speed_refusal(request.rig, request.numbers["speed_rpm"])


SPEED = {"speed_rpm": Number("speed, rpm", point_speed_rpm)}
KIND = TestKind(
    "point",
    "spin up with locked pendulums, release, record until all is steady",
    ("x", "y", "angles", "phase"),
    turns=True,
    table=_table,
    gives=("c3_Nms_per_rad", "c4_Nms_per_rad"),
    point="named",
    numbers=SPEED,
    refusal=refusal,
)
