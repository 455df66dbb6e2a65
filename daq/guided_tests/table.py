# pyright: strict
"""A guided test as a table of states: what each does, what it waits for, how long, and where each outcome leads.

A row is read by the runner, by `rig test … --plan` and by the model check alike, so the table is the documentation.

    entry      orders are given (rotor, locks, log, operator)
    look       a function without side effects of the signals and of what earlier looks remembered, every `period_s`
    DONE       to the row named by `done`, else to the next row
    LATE       `limit_s` has passed: to the row named by `late`, else to the ending; "fault" is an error of the rig
    ABORT      the operator ends the test: to the ending, from every row before it
    an error   interlocks and devices: no row follows, the rotor is stopped and the error ends the test

The ending is the same for every test: it ends the log, brings the rotor to rest and locks the pendulums.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from daq.guided_tests.measures import Measures
    from daq.guided_tests.orders import Orders

END, FAULT = "end", "fault"
"""Where a test is over: in order, or with an error of the rig."""
MOTION = "the motion is being recorded and does not wait"
"""Why a test is not paused while something rings, swings or settles."""

Actor = Literal["program", "rotor", "locks", "operator"]


class Outcome(StrEnum):
    """What a state came to."""

    DONE = "done"
    LATE = "late"
    ABORT = "abort"


@dataclass(frozen=True)
class View:
    """What a look may use.

    Attributes:
        measures: the newest stretch of each signal.
        now_ns, entered_ns: host time, now and when the state had been entered, ns since 1970.
        asked_ns: host time when its entry began: what a person does while being asked counts, ns since 1970.
        rpm: the rotor's speed; NaN where it is not measured.
        memory: what entries and earlier looks remembered.
    """

    measures: Measures
    now_ns: int
    entered_ns: int
    asked_ns: int
    rpm: float
    memory: Mapping[str, Any]

    @property
    def in_state_s(self) -> float:
        """Rig time since the state was entered, s."""
        return (self.now_ns - self.entered_ns) * 1e-9


@dataclass(frozen=True)
class Look:
    """What a look found.

    Attributes:
        done: whether what the state waits for has come.
        words: for the operator.
        share: of the state that is done, 0 … 1; None where that cannot be estimated.
        remember: for later looks and states.
        facts: for the log's summary.
    """

    done: bool
    words: str = ""
    share: float | None = None
    remember: Mapping[str, Any] = field(default_factory=dict[str, Any])
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])


def at_once(view: View) -> Look:
    """For a state that is over when its orders have been carried out."""
    return Look(True)


def after(seconds: float, words: str = "") -> Callable[[View], Look]:
    """A look that waits for some rig time."""
    return lambda view: Look(view.in_state_s >= seconds, words, min(1.0, view.in_state_s / seconds))


def no_orders(orders: Orders) -> None:
    """For a state that only waits."""


def not_missed(view: View) -> str:
    """For a state whose limit is no failure."""
    return ""


@dataclass(frozen=True)
class State:
    """One row of a test's table.

    Attributes:
        name: unique in the table.
        does: what happens on entry, in words.
        enter: orders given on entry.
        waits_for: what ends the state, in words; empty for one that is over with its orders.
        look: see Look.
        period_s: rig time between two looks.
        limit_s: how long it may take: rig time, or wall time where a person or a mechanism is waited for.
        wall: whether `limit_s` is wall time.
        usual_s: how long it takes as a rule, rig time, for the plan.
        actor: who acts; "rotor" and "locks" are a device, or the operator where the rig has none.
        asks: what the operator is asked for where the operator acts.
        rpm: the rotor's speed at the state's end.
        no_pause: why the test must not wait here; empty where it may.
        done, late: rows that follow these outcomes; empty: the next row, the ending.
        missed: after LATE, what was not reached; empty where that is no failure.
        late_warning: after LATE, what the operator has to be told; empty: nothing.
        fact: key of the log's summary that holds whether the outcome was DONE; empty: none.
    """

    name: str
    does: str = ""
    enter: Callable[[Orders], None] = no_orders
    waits_for: str = ""
    look: Callable[[View], Look] = at_once
    period_s: float = 0.5
    limit_s: float = 0.0
    wall: bool = False
    usual_s: float = 0.0
    actor: Actor = "program"
    asks: str = ""
    rpm: float = 0.0
    no_pause: str = ""
    done: str = ""
    late: str = ""
    missed: Callable[[View], str] = not_missed
    late_warning: str = ""
    fact: str = ""


@dataclass(frozen=True)
class Table:
    """The states of one test in their usual order.

    Args:
        states: rows before the ending; the first is entered first.
        ending: rows that every test ends with, whatever it came to.

    Raises:
        ValueError: two rows of one name, or a transition to a row that is not there.
    """

    states: tuple[State, ...]
    ending: tuple[State, ...]

    def __post_init__(self) -> None:
        names = [state.name for state in self.rows]
        if twice := {name for name in names if names.count(name) > 1} | ({END, FAULT} & set(names)):
            raise ValueError(
                f"a guided test's table needs rows of different names, got {', '.join(sorted(twice))} twice"
            )
        for (name, outcome), target in self.transitions.items():
            if target not in (*names, END, FAULT):
                raise ValueError(f"{name}: {outcome} leads to {target!r}; expected one of {', '.join(names)}")

    @property
    def rows(self) -> tuple[State, ...]:
        """All states, the ending's last."""
        return (*self.states, *self.ending)

    @property
    def transitions(self) -> Mapping[tuple[str, Outcome], str]:
        """Where every outcome of every state leads."""
        rows, found = self.rows, dict[tuple[str, Outcome], str]()
        first_of_ending = self.ending[0].name if self.ending else END
        for state, following in zip(rows, [*(row.name for row in rows[1:]), END], strict=True):
            ending = state in self.ending
            found[state.name, Outcome.DONE] = state.done or following
            found[state.name, Outcome.LATE] = state.late or (following if ending else first_of_ending)
            found[state.name, Outcome.ABORT] = following if ending else first_of_ending
        return found

    def row(self, name: str) -> State:
        """The state of a name."""
        return next(state for state in self.rows if state.name == name)
