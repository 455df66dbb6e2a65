# pyright: strict
"""What a guided test will do, without opening a device: its table with the rig's numbers and who acts."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from daq.guided_tests.kinds import CHANNELS, SIGNALS, Asked, given_on
from daq.guided_tests.table import END, FAULT, Outcome, State
from rig_configs.roles import Roles

OPERATOR, PROGRAM = "operator", "program"
_LAST = {END: "the test is over", FAULT: "an error of the rig"}


@dataclass(frozen=True)
class PlannedState:
    """One state of a plan.

    Attributes:
        name, does, waits_for: as in the table.
        who: a device's name, "operator" or "program".
        asks: what the operator is asked for; empty where a device or the program acts.
        rpm: the rotor's speed at its end.
        usual_s: how long it takes as a rule, rig time.
        limit_s: how long it may take; 0 where its orders have time limits of their own.
        limit_is_wall: whether the limit is wall time.
        no_pause: why a test must not wait here; empty where it may.
        done, late: the states that follow.
    """

    name: str
    does: str
    waits_for: str
    who: str
    asks: str
    rpm: float
    usual_s: float
    limit_s: float
    limit_is_wall: bool
    no_pause: str
    done: str
    late: str


@dataclass(frozen=True)
class Plan:
    """A test as it will be run.

    Attributes:
        test, line: its name, what it does.
        needs: which device measures what, by signal.
        gives: parameters that identification may take from it.
        numbers: what it was asked for.
        states: in their usual order.
        repeats: how many times it is run.
        usual_s: how long all of it takes as a rule, rig time.
        top_rpm: the highest speed.
        limit_rpm, limit_m: of the interlocks.
        warning: what it cannot show; empty when nothing.
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
        """What the operator will be asked for, in order."""
        return tuple(state.asks for state in self.states if state.asks)

    def facts(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {**asdict(self), "prompts": list(self.prompts)}


def plan(asked: Asked) -> Plan:
    """The plan of a test that was not refused."""
    rig, kind = asked.rig, asked.kind
    table = kind.table(asked)
    leads = table.transitions
    states = tuple(
        _planned(row, rig.roles, leads[row.name, Outcome.DONE], leads[row.name, Outcome.LATE]) for row in table.rows
    )
    repeats = int(asked.numbers.get("count", 1)) if kind.summed else 1
    device_of = rig.roles.device_of
    return Plan(
        test=asked.test,
        line=kind.line,
        needs={SIGNALS[signal]: device_of[CHANNELS[signal]] for signal in kind.needs},
        gives=given_on(kind, rig.roles),
        numbers=dict(asked.numbers),
        states=states,
        repeats=repeats,
        usual_s=repeats * sum(state.usual_s for state in states),
        top_rpm=max((state.rpm for state in states), default=0.0),
        limit_rpm=rig.limits.speed_rpm,
        limit_m=rig.limits.amplitude_m,
        warning=kind.warning(asked),
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
        limit_s=state.limit_s,
        limit_is_wall=state.wall,
        no_pause=state.no_pause,
        done=_LAST.get(done, done),
        late=_LAST.get(late, late) if state.waits_for else "",
    )
