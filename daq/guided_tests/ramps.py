"""Run-up and run-down: a ramp through both resonances with locked pendulums."""

from __future__ import annotations

from daq.guided_test_kinds import GuidedTestRequest, Number, TestKind
from daq.guided_tests.frame import framed, share_of, spin_up
from daq.guided_tests.orders import RigOrders
from daq.guided_tests.table import State, StateObservation, StateTable, StateView, after
from daq.guided_tests.test_inputs import default_top_rpm, ramp_refusal, ramp_warning

_MIN_SPEED_SHARE = 0.03  # of the top speed; below it a run-down has too few index marks and ends
_RAMP_S = 40.0
_THROUGH = "the rotor passes through resonances"


def _up(request: GuidedTestRequest) -> StateTable:
    top, duration = request.numbers["top_rpm"], request.numbers["duration_s"]

    def at_top(view: StateView) -> StateObservation:
        return StateObservation(view.rpm > 0.985 * top, f"{view.rpm:.0f} rpm", share_of(view.rpm, top))

    def begin(orders: RigOrders) -> None:
        orders.make_ready()
        orders.begin()

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
            enter=lambda orders: orders.turn(top, top / duration),
            asks=f"turn the rotor up to {top:.0f} rpm with a steady ramp of {top / duration:.0f} rpm per second",
            waits_for=f"{0.985 * top:.0f} rpm",
            look=at_top,
            usual_s=duration,
            limit_s=1.5 * duration,
            missed=lambda view: f"the top speed: {view.rpm:.0f} of {top:.0f} rpm after {1.5 * duration:g} s",
            fact="reached_top",
            no_pause=_THROUGH,
        ),
        State(
            "top",
            waits_for="a second at the top",
            look=after(1.0),
            usual_s=1.0,
            limit_s=60.0,
            rpm=top,
            no_pause="the ramp is being recorded and does not wait",
        ),
    )


def _down(request: GuidedTestRequest) -> StateTable:
    top, duration = request.numbers["top_rpm"], request.numbers["duration_s"]

    def slow(view: StateView) -> StateObservation:
        return StateObservation(view.rpm < _MIN_SPEED_SHARE * top, f"{view.rpm:.0f} rpm", share_of(top - view.rpm, top))

    return framed(
        request,
        *spin_up(request, top),
        State(
            "top",
            does="begin the log",
            enter=RigOrders.begin,
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
            enter=lambda orders: orders.turn(0.0, top / duration),
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
