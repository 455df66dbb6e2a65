"""Run-up and run-down: a ramp through both resonances with locked pendulums."""

from __future__ import annotations

import math

from daq.guided_test_kinds import GuidedTestRequest, Number, TestKind
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.frame import framed, share_of, speed_advice, speeds_of, spin_up
from daq.guided_tests.table import State, StateObservation, StateTable, StateView, after
from daq.guided_tests.test_inputs import default_top_rpm, ramp_refusal, ramp_warning

_MIN_SPEED_SHARE = 0.03  # of the top speed; below it a run-down has too few index marks and ends
_TOP_SHARE = 0.015  # deviation from the top speed that counts as reached
_AT_TOP_S, _MAX_AT_TOP_S = 1.0, 10.0  # s; the longer time lets an overshoot of the drive's control decay
_RAMP_S = 40.0
_THROUGH = "the rotor passes through resonances"


def _up(request: GuidedTestRequest) -> StateTable:
    top, duration = request.numbers["top_rpm"], request.numbers["duration_s"]

    def at_top(view: StateView) -> StateObservation:
        reached = min(speeds_of(view)) > (1 - _TOP_SHARE) * top
        return StateObservation(reached, _words(view.rpm), share_of(view.rpm, top))

    def not_beyond(view: StateView) -> StateObservation:
        held = view.in_state_s >= _AT_TOP_S and max(speeds_of(view)) <= (1 + _TOP_SHARE) * top
        return StateObservation(held, _words(view.rpm), min(1.0, view.in_state_s / _AT_TOP_S))

    def begin(commands: RigCommands) -> None:
        commands.make_ready()
        commands.begin()

    return framed(
        request,
        State(
            "begin",
            does="make ready to turn the rotor, begin the log",
            enter=begin,
            actor="rotor",
            waits_for="half a second at rest",
            look=after(0.5),
            usual_s=0.7,
            limit_s=60.0,
            period_s=0.1,
        ),
        State(
            "ramp",
            does=f"ramp to {top:.0f} rpm in {duration:g} s",
            actor="rotor",
            rpm=top,
            enter=lambda commands: commands.turn(top, top / duration),
            asks=f"turn the rotor up to {top:.0f} rpm with a steady ramp of {top / duration:.0f} rpm per second",
            waits_for=f"{(1 - _TOP_SHARE) * top:.0f} rpm",
            look=at_top,
            usual_s=duration,
            limit_s=1.5 * duration,
            missed=lambda view: _not_at_top(request, view, top),
            fact="reached_top",
            no_pause=_THROUGH,
        ),
        State(
            "top",
            waits_for=f"a second at the top, at most {(1 + _TOP_SHARE) * top:.0f} rpm",
            look=not_beyond,
            usual_s=1.0,
            limit_s=_MAX_AT_TOP_S,
            rpm=top,
            missed=lambda view: _not_at_top(request, view, top),
            fact="reached_top",
            no_pause="the ramp is being recorded and does not wait",
        ),
    )


def _words(rpm: float) -> str:
    return "the speed is not measured yet" if math.isnan(rpm) else f"{rpm:.0f} rpm"


def _not_at_top(request: GuidedTestRequest, view: StateView, top_rpm: float) -> str:
    advice = speed_advice(view) if request.rig.roles.speed else ""
    return f"the top speed: {view.rpm:.0f} of {top_rpm:.0f} rpm after {view.in_state_s:.0f} s{advice}"


def _down(request: GuidedTestRequest) -> StateTable:
    top, duration = request.numbers["top_rpm"], request.numbers["duration_s"]

    def slow(view: StateView) -> StateObservation:
        rpm = min(speeds_of(view))  # a slow rotor's marks are seconds apart
        return StateObservation(rpm < _MIN_SPEED_SHARE * top, _words(rpm), share_of(top - rpm, top))

    return framed(
        request,
        *spin_up(request, top),
        State(
            "top",
            does="begin the log",
            enter=RigCommands.begin,
            waits_for="a second at the top",
            look=after(1.0),
            usual_s=1.0,
            limit_s=60.0,
            rpm=top,
            no_pause="the ramp is being recorded and does not wait",
        ),
        State(
            "ramp",
            does=f"ramp to rest in {duration:g} s",
            enter=lambda commands: commands.turn(0.0, top / duration),
            actor="rotor",
            asks=f"bring the rotor to rest with a steady ramp of {top / duration:.0f} rpm per second",
            waits_for=f"{_MIN_SPEED_SHARE * top:.0f} rpm",
            look=slow,
            period_s=0.2,
            usual_s=duration,
            limit_s=1.5 * duration,
            missed=lambda view: f"the rotor to come to rest: still {view.rpm:.0f} rpm after {1.5 * duration:g} s",
            fact="reached_rest",
            no_pause=_THROUGH,
        ),
    )


def _refusal(request: GuidedTestRequest) -> str:
    return ramp_refusal(request.rig, request.numbers["top_rpm"], request.numbers["duration_s"])


def _warning(request: GuidedTestRequest) -> str:
    return ramp_warning(request.rig, request.numbers["top_rpm"])


_NUMBERS = {
    "top_rpm": Number("top speed, rpm", lambda rig, point: default_top_rpm(rig)),
    "duration_s": Number("duration of the ramp, s", _RAMP_S),
}
_GIVES = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
RUN_UP = TestKind(
    "run-up",
    "ramp from rest through both resonances with locked pendulums",
    ("x", "y", "phase"),
    turns=True,
    table=_up,
    gives=_GIVES,
    numbers=_NUMBERS,
    refusal=_refusal,
    warning=_warning,
)
RUN_DOWN = TestKind(
    "run-down",
    "ramp from above both resonances to rest with locked pendulums",
    ("x", "y", "phase"),
    turns=True,
    table=_down,
    gives=_GIVES,
    numbers=_NUMBERS,
    refusal=_refusal,
    warning=_warning,
)
