"""A guided test as a table of states: commands, condition, time limit and transitions of each state.

The runner, `rig test … --plan` and the model check use the same rows.

    entry      the commands of the state are carried out (rotor, locks, log, operator)
    look       a function without side effects of the signals and of the memory, called every `period_s`
    DONE       the condition is met: the row `done` follows, or the next row
    LATE       `limit_s` has passed: the row `late` follows, or the ending; "fault" is an error of the rig
    ABORT      the operator ends the test: the ending follows
    an error   of an interlock or a device: the rotor is stopped and the error ends the test; no row follows

The ending is the same for every test: it ends the log, brings the rotor to rest and locks the pendulums.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

from daq.guided_tests.commands import RigCommands
from daq.guided_tests.measures import Measures

END, FAULT = "end", "fault"
"""Targets of transitions that end a test: normally, or with an error of the rig."""
MOTION = "the motion is being recorded and does not wait"
"""Reason against a pause while the column rings down or the pendulums move."""

Actor = Literal["program", "rotor", "locks", "operator"]


class StateOutcome(StrEnum):
    """Outcome of a state."""

    DONE = "done"
    LATE = "late"
    ABORT = "abort"


@dataclass(frozen=True)
class StateView:
    """Input of a look.

    Attributes:
        measures: measured values of the signals.
        now_ns: host time, ns since 1970.
        entered_ns: host time at which the commands of the state had been carried out, ns since 1970.
        entry_began_ns: host time before the commands, ns since 1970. Actions of the operator count from here.
        rpm: measured rotor speed, rpm; NaN if it is not measured.
        memory: values that entries and earlier looks have stored.
        reported_rpm: speed that the drive reports, rpm; NaN without a drive or a report.
    """

    measures: Measures
    now_ns: int
    entered_ns: int
    entry_began_ns: int
    rpm: float
    memory: Mapping[str, Any]
    reported_rpm: float = math.nan

    @property
    def in_state_s(self) -> float:
        """Time since the state was entered, s."""
        return (self.now_ns - self.entered_ns) * 1e-9


@dataclass(frozen=True)
class StateObservation:
    """Result of a look.

    Attributes:
        done: whether the condition of the state is met.
        words: description of the progress for the operator.
        share: completed share of the state, 0 … 1; None if it cannot be estimated.
        store: values to store in the memory for later looks and states.
        facts: facts for the summary of the log.
        near: whether the condition will be met within the state's `extension_s` if the signals go on as they do.
    """

    done: bool
    words: str = ""
    share: float | None = None
    store: Mapping[str, Any] = field(default_factory=dict[str, Any])
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])
    near: bool = False


def at_once(view: StateView) -> StateObservation:
    """Return a look that is done, for states that are over when their commands have been carried out."""
    return StateObservation(True)


def after(seconds: float, words: str = "") -> Callable[[StateView], StateObservation]:
    """Return a look that waits for a time, s."""
    return lambda view: StateObservation(view.in_state_s >= seconds, words, min(1.0, view.in_state_s / seconds))


def no_commands(commands: RigCommands) -> None:
    """Do nothing on entry, for states that only wait."""


def not_missed(view: StateView) -> str:
    """Return an empty text, for states whose time limit is not a failure."""
    return ""


@dataclass(frozen=True)
class State:
    """One row of a test's table.

    Attributes:
        name: name of the state, unique in the table.
        does: description of the commands on entry; empty without commands.
        enter: carries out the commands on entry.
        waits_for: description of the condition; empty for states that are over with their commands.
        look: evaluates the condition.
        period_s: period of the looks, s.
        limit_s: time limit, s.
        extension_s: longest extension of the time limit, s; it lasts while the looks report `near`.
        usual_s: usual duration for the plan, s.
        actor: who acts. "rotor" and "locks" stand for a device, or for the operator if the rig has no such device.
        asks: request to the operator if the operator acts.
        rpm: rotor speed at the end of the state, rpm.
        no_pause: reason why the test must not pause here; empty if it may.
        done, late: names of the rows that follow these outcomes; empty for the next row and for the ending.
        missed: returns the condition that was not reached after LATE; empty if the time limit is not a failure.
        late_warning: warning for the operator after LATE; empty for none.
        fact: key of the log's summary for whether the outcome was DONE; empty for none.
    """

    name: str
    does: str = ""
    enter: Callable[[RigCommands], object] = no_commands
    waits_for: str = ""
    look: Callable[[StateView], StateObservation] = at_once
    period_s: float = 0.5
    limit_s: float = 0.0
    extension_s: float = 0.0
    usual_s: float = 0.0
    actor: Actor = "program"
    asks: str = ""
    rpm: float = 0.0
    no_pause: str = ""
    done: str = ""
    late: str = ""
    missed: Callable[[StateView], str] = not_missed
    late_warning: str = ""
    fact: str = ""


@dataclass(frozen=True)
class StateTable:
    """The states of one test in their usual order.

    Args:
        states: rows before the ending, starting with the first state.
        ending: rows at the end of the test after every outcome.

    Raises:
        ValueError: two rows have the same name, or a transition leads to a missing row.
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
        """All states, with the ending last."""
        return (*self.states, *self.ending)

    @property
    def transitions(self) -> Mapping[tuple[str, StateOutcome], str]:
        """Name of the state that follows each outcome of each state."""
        rows, found = self.rows, dict[tuple[str, StateOutcome], str]()
        first_of_ending = self.ending[0].name if self.ending else END
        for state, following in zip(rows, [*(row.name for row in rows[1:]), END], strict=True):
            ending = state in self.ending
            found[state.name, StateOutcome.DONE] = state.done or following
            found[state.name, StateOutcome.LATE] = state.late or (following if ending else first_of_ending)
            found[state.name, StateOutcome.ABORT] = following if ending else first_of_ending
        return found

    def row(self, name: str) -> State:
        """Return the state of a name."""
        return next(state for state in self.rows if state.name == name)
