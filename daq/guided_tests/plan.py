"""Plan of a guided test: its table with the numbers of the rig and the actor of each state. No device is opened."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from daq.guided_test_kinds import CHANNELS, SIGNALS, GuidedTestRequest, given_on
from daq.guided_tests.table import END, FAULT, State, StateOutcome
from rig_configs.roles import Roles

OPERATOR, PROGRAM = "operator", "program"
_LAST = {END: "the test is over", FAULT: "an error of the rig"}


@dataclass(frozen=True)
class PlannedState:
    """One state of a plan.

    Attributes:
        name, does, waits_for: as in State.
        who: name of the acting device, "operator" or "program".
        asks: request to the operator; empty if a device or the program acts.
        rpm: rotor speed at the end of the state, rpm.
        usual_s: usual duration, s.
        limit_s: longest permitted duration, s; 0 if the commands have timeouts of their own.
        no_pause: reason why the test must not pause here; empty if it may.
        done, late: names of the states that follow these outcomes.
    """

    name: str
    does: str
    waits_for: str
    who: str
    asks: str
    rpm: float
    usual_s: float
    limit_s: float
    no_pause: str
    done: str
    late: str


@dataclass(frozen=True)
class GuidedTestPlan:
    """Plan of a requested test.

    Attributes:
        test, line: name and description of the test.
        needs: name of the measuring device, by signal.
        gives: parameters that identification may take from the log.
        numbers: numbers of the test, by name.
        states: states in their usual order.
        repeats: number of runs.
        usual_s: usual duration of all runs, s.
        top_rpm: highest speed, rpm.
        limit_rpm, limit_m: limits of the interlocks, rpm and m.
        warning: limitation of the test; empty if there is none.
    """

    test: str
    line: str
    needs: dict[str, str]
    gives: tuple[str, ...]
    numbers: dict[str, float]
    states: tuple[PlannedState, ...]
    repeats: int
    usual_s: float
    top_rpm: float
    limit_rpm: float
    limit_m: float
    warning: str

    @property
    def prompts(self) -> tuple[str, ...]:
        """Requests to the operator in their order."""
        return tuple(state.asks for state in self.states if state.asks)

    def facts(self) -> dict[str, Any]:
        """Return the plan as JSON values."""
        return {**asdict(self), "prompts": list(self.prompts)}


def plan(request: GuidedTestRequest) -> GuidedTestPlan:
    """Return the plan of a requested test."""
    rig, kind = request.rig, request.kind
    table = kind.table(request)
    leads = table.transitions
    states = tuple(
        _planned(row, rig.roles, leads[row.name, StateOutcome.DONE], leads[row.name, StateOutcome.LATE])
        for row in table.rows
    )
    repeats = int(request.numbers.get("count", 1)) if kind.combined else 1
    device_of = rig.roles.device_of
    return GuidedTestPlan(
        test=request.test,
        line=kind.summary,
        needs={SIGNALS[signal]: device_of[CHANNELS[signal]] for signal in kind.needs},
        gives=given_on(kind, rig.roles),
        numbers=dict(request.numbers),
        states=states,
        repeats=repeats,
        usual_s=repeats * sum(state.usual_s for state in states),
        top_rpm=max((state.rpm for state in states), default=0.0),
        limit_rpm=rig.limits.speed_rpm,
        limit_m=rig.limits.amplitude_m,
        warning=kind.warning(request),
    )


def _planned(state: State, roles: Roles, done: str, late: str) -> PlannedState:
    device = {"rotor": roles.speed, "locks": roles.locks}.get(state.actor)
    who = PROGRAM if state.actor == "program" else OPERATOR if device is None else device.device
    return PlannedState(
        name=state.name,
        does=state.does,
        waits_for=state.waits_for,
        who=who,
        asks=state.asks if who == OPERATOR else "",
        rpm=state.rpm,
        usual_s=state.usual_s,
        limit_s=state.limit_s + state.extension_s,
        no_pause=state.no_pause,
        done=_LAST.get(done, done),
        late=_LAST.get(late, late) if state.waits_for else "",
    )
