"""Execution of a test's table: commands, looks, outcomes, transitions, and the requests of the operator.

All waits of a guided test are in this module, on the session's clock. It starts no thread and opens no file.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.errors import DeviceError, ProcedureError
from daq.guided_test_kinds import GuidedTestRequest
from daq.guided_tests.commands import RigCommands, TestDemands
from daq.guided_tests.controls import Controls, GuidedTestStatus, Request
from daq.guided_tests.hands import Wait
from daq.guided_tests.table import END, FAULT, State, StateObservation, StateOutcome, StateTable, StateView

_log = logging.getLogger(__name__)

_PAUSE_LOOK_S = 0.1  # period of the looks while a test is paused, s


@dataclass(frozen=True)
class TestDone:
    """Result of a finished test.

    Attributes:
        test: name of the test.
        log: path of the finished log; for a repeated test the last one.
        summary: facts of the log's summary; for a repeated test the combined summary of its runs.
        missed: condition that was not reached; empty if the test reached its end.
        warnings: warnings for the operator.
        aborted: whether the operator ended the test.
        runs: results of the runs of a repeated test.
    """

    __test__ = False  # not a pytest class

    test: str
    log: Path
    summary: Mapping[str, Any]
    missed: str = ""
    warnings: tuple[str, ...] = ()
    aborted: bool = False
    runs: tuple[TestDone, ...] = ()


class NotReached(ProcedureError):
    """A test ended before its log began.

    Attributes:
        aborted: whether the operator ended the test.
    """

    aborted = False


class _Aborted(Exception):
    """The operator ended the test."""


class Runner:
    """Runs the tests of one session, one after the other.

    Args:
        make: returns what carries out the commands of the states, with a wait that a request of the operator can end.
        controls: passes the requests of the operator.
    """

    def __init__(self, make: Callable[[Wait], RigCommands], controls: Controls) -> None:
        self._commands, self._controls = make(self._wait), controls
        self._clock = self._commands.clock
        self._abort: str | None = None
        self._pausing = False
        self._ending: frozenset[str] = frozenset()

    def run(self, request: GuidedTestRequest, table: StateTable, facts: Mapping[str, str]) -> TestDone:
        """Run a test to its end.

        Args:
            request: the requested test.
            table: states of the test.
            facts: facts for the metadata of its log.

        Raises:
            NotReached: the test ended before its log began.
            AcquisitionError: an interlock, a device or an encoder ended the test. The rotor was stopped.
        """
        commands = self._commands
        self._request, kind = request, request.kind
        required = kind.required_at_rest(commands.session.rig.roles)
        commands.prepare(TestDemands(request.test, required, kind.trusts_angles), facts)
        commands.warn(request.kind.warning(request))
        self._abort, self._ending = None, frozenset(row.name for row in table.ending)
        try:
            transitions, name = table.transitions, table.rows[0].name
            while name != END:
                state = table.row(name)
                outcome = self._outcome(state)
                name = transitions[name, outcome]
                self._conclude(state, outcome, name)
        except BaseException:
            _attempt("the quick stop", commands.quick_stop)
            _attempt("recording what happened so far", commands.record_past)
            raise
        return self._done()

    def _done(self) -> TestDone:
        commands = self._commands
        if commands.kept is None:
            error = NotReached(commands.missed or "the table of the test does not begin a log")
            error.aborted = commands.aborted
            raise error
        facts, warnings = commands.kept.summary, tuple(commands.warnings)
        return TestDone(self._request.test, commands.kept.log, facts, commands.missed, warnings, commands.aborted)

    # --- one state ---------------------------------------------------------------------------------------------

    def _outcome(self, state: State) -> StateOutcome:
        """Enter a state and look until it is over."""
        commands = self._commands
        self._show(state, StateObservation(False, state.does or f"waiting for {state.waits_for}"))
        self._entered = state
        try:
            self._take_requests(state)
            entry_began_ns = self._clock.now_ns()
            state.enter(commands)
            entered_ns = self._clock.now_ns()
            end_ns = entered_ns + int(state.limit_s * 1e9)
            while True:
                commands.check()
                end_ns += self._take_requests(state)
                look = state.look(self._view(entry_began_ns, entered_ns))
                commands.memory.update(look.store)
                commands.facts.update(look.facts)
                self._show(state, look)
                if look.done:
                    return StateOutcome.DONE
                if self._clock.now_ns() > end_ns + int(look.near * state.extension_s * 1e9):
                    return self._late(state, self._view(entry_began_ns, entered_ns))
                self._clock.wait(state.period_s)
        except _Aborted:  # usual: a request of the operator
            return StateOutcome.ABORT

    def _view(self, entry_began_ns: int, entered_ns: int) -> StateView:
        commands = self._commands
        rotor, now_ns = commands.rotor, self._clock.now_ns()
        return StateView(
            commands.measures, now_ns, entered_ns, entry_began_ns, rotor.speed_rpm, commands.memory, rotor.reported_rpm
        )

    def _late(self, state: State, view: StateView) -> StateOutcome:
        self._commands.miss(state.missed(view))
        self._commands.warn(state.late_warning)
        return StateOutcome.LATE

    def _conclude(self, state: State, outcome: StateOutcome, target: str) -> None:
        """Record an outcome, and raise the error of a transition to FAULT."""
        commands = self._commands
        if outcome is StateOutcome.ABORT:
            commands.abort(f"aborted by the operator in {state.name!r}: {self._abort}")
            self._abort = None
        elif state.fact:
            commands.facts[state.fact] = outcome is StateOutcome.DONE
        if target == FAULT:
            raise DeviceError(commands.missed)

    # --- requests of the operator ------------------------------------------------------------------------------

    def _wait(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for a condition as Session.wait_for does. An abort ends the wait."""

        def over() -> bool:
            for request in self._controls.take():
                self._take(self._entered, request)
            return self._abort is not None or condition()

        self._commands.session.wait_for(over, seconds, what)
        if self._abort is not None:
            raise _Aborted

    def _take_requests(self, state: State) -> int:
        """Take the waiting requests, wait while the test is paused, and return the duration of the wait, ns."""
        begun = self._clock.now_ns()
        while True:
            for request in self._controls.take():
                self._take(state, request)
            if self._abort is not None:
                raise _Aborted
            if not self._pausing or state.no_pause:
                break
            self._show(state, StateObservation(False, f"paused before: {state.does or state.waits_for}"), paused=True)
            self._commands.check()
            self._clock.wait(_PAUSE_LOOK_S)
        return self._clock.now_ns() - begun

    def _take(self, state: State, request: Request) -> None:
        if request.verb == "note":
            self._commands.note(request.text)
            self._answer(f"noted: {request.text}")
        elif request.verb == "abort" and state.name in self._ending and state.actor != "locks":
            self._answer("the test is ending already")
        elif request.verb == "abort":
            self._abort = self._abort or request.text or "no reason given"
            self._answer("the test is being aborted")
        elif request.verb == "resume":
            self._pausing = False
            self._answer("the test continues")
        else:
            self._pausing = True
            later = f"no pause here: {state.no_pause}. The test pauses in the next state that may wait"
            self._answer(later if state.no_pause else "paused")

    def _answer(self, text: str) -> None:
        self._controls.status = replace(self._controls.status, answer=text)

    def _show(self, state: State, look: StateObservation, *, paused: bool = False) -> None:
        words = look.words or (f"waiting for {state.waits_for}" if state.waits_for else state.does)
        answer, request = self._controls.status.answer, self._request
        self._controls.status = GuidedTestStatus(
            request.test, state.name, words, look.share, paused, answer, request.numbers
        )
        self._commands.report(words, look.share)


def _attempt(activity: str, step: Callable[[], object]) -> None:
    """Carry out a step after an error. An error of the step is logged, so that the first error is the one raised."""
    try:
        step()
    except Exception as error:
        _log.warning("%s failed after the error that ended the test: %r", activity, error)
