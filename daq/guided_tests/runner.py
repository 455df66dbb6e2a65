# pyright: strict
"""Runs a test's table: orders, looks, outcomes, transitions; and takes what the operator asks for meanwhile.

The one place where a guided test waits. Time is the session's clock; nothing here starts a thread or opens a file.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.controls import Controls, Request, Status
from daq.guided_tests.kinds import Asked
from daq.guided_tests.orders import Orders
from daq.guided_tests.table import END, FAULT, Look, Outcome, State, Table, View

_PAUSE_LOOK_S = 0.1  # rig time between two looks while a test is paused


@dataclass(frozen=True)
class TestDone:
    """A finished test.

    Attributes:
        test: its name.
        log: its log, finished and whole; of a repeated test the last one.
        summary: the facts that went into the log's summary; of a repeated test the whole of its runs.
        missed: what was not reached; empty when the test came to its end.
        warnings: what its operator has to be told, sentences.
        aborted: whether the operator ended it.
        runs: of a repeated test, each of its runs.
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
    """A test did not reach its end, and no log had begun: there is nothing to keep.

    Attributes:
        aborted: whether the operator ended it.
    """

    aborted = False


class _Aborted(Exception):
    """The operator ended the test while its orders waited for somebody."""


class Runner:
    """Of one session's tests, one after the other.

    Args:
        orders: what states may order.
        controls: what the operator may ask for.
    """

    def __init__(self, orders: Orders, controls: Controls) -> None:
        self._orders, self._controls, self._clock = orders, controls, orders.clock
        self._abort: str | None = None
        self._pausing = False
        self._ending: frozenset[str] = frozenset()
        orders.wait = self._wait

    def run(self, asked: Asked, table: Table, facts: Mapping[str, str]) -> TestDone:
        """Run a test to its end.

        Args:
            asked: the test.
            table: its states.
            facts: for its log's metadata.

        Raises:
            NotReached: it ended before a log began.
            RigError: an interlock, a device or an encoder ended it; the rotor was stopped.
        """
        orders = self._orders
        orders.prepare(asked, facts)
        orders.warn(asked.kind.warning(asked))
        self._abort, self._ending = None, frozenset(row.name for row in table.ending)
        try:
            transitions, name = table.transitions, table.rows[0].name
            while name != END:
                state = table.row(name)
                outcome = self._outcome(state)
                name = transitions[name, outcome]
                self._conclude(state, outcome, name)
        except BaseException:
            with contextlib.suppress(Exception):  # the error that ended the test is the one to raise
                orders.quick_stop()
            with contextlib.suppress(Exception):
                orders.keep_the_past()
            raise
        return self._done()

    def _done(self) -> TestDone:
        orders = self._orders
        if orders.kept is None:
            error = NotReached(orders.missed or "the test's table begins no log")
            error.aborted = orders.aborted
            raise error
        facts, warnings = orders.kept.summary, tuple(orders.warnings)
        return TestDone(orders.asked.test, orders.kept.log, facts, orders.missed, warnings, orders.aborted)

    # --- one state ---------------------------------------------------------------------------------------------

    def _outcome(self, state: State) -> Outcome:
        """Enter a state, look until it is over."""
        orders = self._orders
        self._show(state, Look(False, state.does or f"waiting for {state.waits_for}"))
        self._entered = state
        try:
            self._heed_requests(state)
            asked_ns = self._clock.now_ns()
            state.enter(orders)
            limit_s = self._clock.patience(state.limit_s) if state.wall else state.limit_s
            entered_ns = self._clock.now_ns()
            end_ns = entered_ns + int(limit_s * 1e9)
            while True:
                orders.check()
                end_ns += self._heed_requests(state)
                look = state.look(self._view(asked_ns, entered_ns))
                orders.memory |= look.remember
                orders.facts |= look.facts
                self._show(state, look)
                if look.done:
                    return Outcome.DONE
                if self._clock.now_ns() > end_ns:
                    return self._late(state, self._view(asked_ns, entered_ns))
                self._clock.sleep(state.period_s)
        except _Aborted:
            return Outcome.ABORT

    def _view(self, asked_ns: int, entered_ns: int) -> View:
        orders = self._orders
        now_ns = self._clock.now_ns()
        return View(orders.measures, now_ns, entered_ns, asked_ns, orders.rotor.speed_rpm, orders.memory)

    def _late(self, state: State, view: View) -> Outcome:
        missed = state.missed(view)
        self._orders.missed = self._orders.missed or missed
        self._orders.warn(state.late_warning)
        return Outcome.LATE

    def _conclude(self, state: State, outcome: Outcome, target: str) -> None:
        """What an outcome leaves behind."""
        orders = self._orders
        if outcome is Outcome.ABORT:
            if not orders.aborted and orders.kept is None:
                orders.aborted, orders.missed = True, f"aborted by the operator in {state.name!r}: {self._abort}"
            self._abort = None
        elif state.fact:
            orders.facts[state.fact] = outcome is Outcome.DONE
        if target == FAULT:
            raise DeviceError(orders.missed)

    # --- what the operator asks for ----------------------------------------------------------------------------

    def _wait(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        """See Session.wait_for; an abort ends the wait."""

        def over() -> bool:
            for request in self._controls.take():
                self._take(self._entered, request)
            return self._abort is not None or condition()

        self._orders.session.wait_for(over, wall_s, what)
        if self._abort is not None:
            raise _Aborted

    def _heed_requests(self, state: State) -> int:
        """Take what was asked; while the test is paused, wait here. Returns for how long, ns."""
        begun = self._clock.now_ns()
        while True:
            for request in self._controls.take():
                self._take(state, request)
            if self._abort is not None:
                raise _Aborted
            if not self._pausing or state.no_pause:
                break
            self._show(state, Look(False, f"paused; {state.does or state.waits_for} when it goes on"), paused=True)
            self._orders.check()
            self._clock.sleep(_PAUSE_LOOK_S)
        return self._clock.now_ns() - begun

    def _take(self, state: State, request: Request) -> None:
        if request.verb == "note":
            self._orders.note(request.text)
            self._answer(f"noted: {request.text}")
        elif request.verb == "abort" and state.name in self._ending and state.actor != "locks":
            self._answer("the test is ending already")
        elif request.verb == "abort":
            self._abort = self._abort or request.text or "no reason given"
            self._answer("the test is being aborted")
        elif request.verb == "resume":
            self._pausing = False
            self._answer("going on")
        else:
            self._pausing = True
            later = f"not here: {state.no_pause}. The test pauses in the next state that may wait"
            self._answer(later if state.no_pause else "paused")

    def _answer(self, text: str) -> None:
        self._controls.status = replace(self._controls.status, answer=text)

    def _show(self, state: State, look: Look, *, paused: bool = False) -> None:
        words = look.words or (f"waiting for {state.waits_for}" if state.waits_for else state.does)
        answer, asked = self._controls.status.answer, self._orders.asked
        self._controls.status = Status(asked.test, state.name, words, look.share, paused, answer, asked.numbers)
        self._orders.tell(words, look.share)
