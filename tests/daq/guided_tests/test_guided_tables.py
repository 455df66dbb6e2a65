"""Tables of all guided tests: every path ends with the rotor at rest and the log finished, without a wrong command."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
from hypothesis import given, strategies as st

from daq.errors import DeviceError
from daq.guided_test_kinds import KINDS, GuidedTestRequest
from daq.guided_tests.controls import Controls
from daq.guided_tests.frame import FINISH, STOP, framed
from daq.guided_tests.procedure import Procedures
from daq.guided_tests.runner import NotReached, TestDone
from daq.guided_tests.table import END, FAULT, State, StateObservation, StateOutcome, StateTable, StateView
from daq.guided_tests.test_inputs import requested_test
from daq.signals.settling import Settling
from rig_configs import load_rig
from tests.daq.bench_without_rig import Bench, finished, plays, reached_its_log, scripted

if TYPE_CHECKING:
    from daq.guided_tests.measures import Measures

RIG, HAND = load_rig("virtual"), load_rig("by_hand")
ASKED = {
    name: requested_test(
        RIG, "point-B" if name == "point" else name, {"speed_rpm": 288.0} if name == "start-ups" else {}
    )
    for name in KINDS
}
FROM_REST = "start-ups from rest"
ASKED[FROM_REST] = requested_test(RIG, "start-ups", {"speed_rpm": 288.0, "from_rest": 1})
STEPS = ("wait", "done", "done", "done", "abort", "abort and done", "pause", "note", "fault")


def table_of(name: str) -> StateTable:
    return ASKED[name].kind.table(ASKED[name])


@pytest.mark.parametrize("name", list(ASKED))
def test_every_outcome_leads_forward_and_every_wait_has_a_limit(name: str) -> None:
    table = table_of(name)
    place = {row.name: number for number, row in enumerate(table.rows)} | {END: 99, FAULT: 99}
    for (row, outcome), target in table.transitions.items():
        assert place[target] > place[row], (row, outcome, target)
    assert [row.name for row in table.rows if row.waits_for and row.limit_s <= 0] == []
    assert {table.transitions[row.name, StateOutcome.ABORT] for row in table.states} == {FINISH.name}
    assert [row.name for row in table.ending][:2] == [FINISH.name, STOP.name]


def test_a_speed_that_is_not_measured_yet_is_reported() -> None:
    wanted = requested_test(HAND, "point-A", {})
    (up,) = [row for row in wanted.kind.table(wanted).rows if row.name == "spin up"]
    look = up.look(StateView(cast("Measures", None), 0, 0, 0, float("nan"), {}))
    assert (look.done, look.words) == (False, "spinning up to 149 rpm: the speed is not measured yet")


@pytest.mark.parametrize("name", [name for name in ASKED if ASKED[name].kind.turns])
def test_no_test_waits_while_the_rotor_passes_through_resonances_or_comes_to_rest(name: str) -> None:
    table = table_of(name)
    for row in table.rows:
        if row.actor == "rotor" and (row.rpm or row.does.startswith("ramp") or row.name == STOP.name):
            assert row.no_pause


def test_a_point_in_a_resonance_is_not_paused_there() -> None:
    second_rpm = max(RIG.physics.natural_frequencies_rad_s) * 30 / 3.14159265
    for rpm, waits in ((second_rpm, False), (0.7 * second_rpm, True)):
        there = requested_test(RIG, "point-B", {"speed_rpm": rpm})
        assert (there.kind.table(there).row("steady orbit").no_pause == "") is waits


@given(
    name=st.sampled_from(sorted(ASKED)),
    script=st.lists(st.sampled_from(STEPS), max_size=25),
    fails_at=st.none() | st.integers(1, 14),
    aborted_at=st.none() | st.integers(1, 14),
)
def test_a_test_always_ends_at_rest_with_its_log_ended_and_no_wrong_command(
    name: str, script: list[str], fails_at: int | None, aborted_at: int | None
) -> None:
    controls, bench = Controls(), Bench(RIG, fails_at)
    bench.while_commanded = lambda number: controls.abort("again") if number == aborted_at else None
    table = scripted(table_of(name), plays(script, controls, bench))
    with tempfile.TemporaryDirectory() as folder:
        done = finished(bench, ASKED[name], table, controls, Path(folder))
    assert bench.wrong == []
    assert not bench.turning
    broken = bench.fault is not None or (fails_at is not None and fails_at <= len(bench.commands))
    if isinstance(done, TestDone):
        summary = bench.logs[-1]["summary"]
        assert summary["reached"] is (done.missed == "")
        assert done.aborted is ("aborted by the operator" in summary["ended"])
    elif not broken:
        assert isinstance(done, NotReached) or str(done) == "what was waited for"
    if not broken and not isinstance(done, DeviceError):  # an error leaves the log to the session
        assert not bench.recording
        assert bench.commands.count("begin the log") == bench.commands.count("end the log") <= 1
        assert bench.locked or "release" not in bench.commands or aborted_at is not None  # the operator gave it up


@pytest.mark.parametrize("during", ["commands", "looks"])
@pytest.mark.parametrize("name", list(ASKED))
def test_an_abort_at_any_instant_skips_neither_the_logs_end_nor_the_rest(
    name: str, during: str, tmp_path: Path
) -> None:
    for number in range(1, 20):
        controls, bench = Controls(), Bench(RIG)
        if during == "commands":
            bench.while_commanded = lambda now, at=number, c=controls: c.abort("smoke") if now >= at else None
        look = plays(["done"] * (number - 1) + [f"{'abort and ' * (during == 'looks')}done"] * 20, controls, bench)
        finished(bench, ASKED[name], scripted(table_of(name), look), controls, tmp_path)
        assert not bench.turning
        assert not bench.recording


@pytest.mark.parametrize("name", list(ASKED))
def test_a_test_that_goes_well_reaches_its_end(name: str, tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    table = scripted(table_of(name), plays(["done"] * 30, controls, bench))
    done = reached_its_log(bench, ASKED[name], table, controls, tmp_path)
    assert (done.missed, done.aborted, done.summary["reached"]) == ("", False, True)
    assert bench.logs[-1]["test"] == ASKED[name].test


def test_an_abort_keeps_the_log_with_its_reason_and_brings_the_rotor_to_rest_before_the_locks_close(
    tmp_path: Path,
) -> None:
    controls, bench = Controls(), Bench(RIG)

    def look(state: State, view: StateView) -> StateObservation:
        if state.name == "settle":
            controls.abort("smoke")
        return StateObservation(state.name != "settle")

    done = reached_its_log(bench, ASKED["point"], scripted(table_of("point"), look), controls, tmp_path)
    assert done.summary["ended"] == "not reached: aborted by the operator in 'settle': smoke"
    assert bench.commands[-4:] == ["release", "end the log", "rest", "lock"]


def test_a_test_that_ends_before_its_log_reports_it_and_keeps_no_log(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    table = scripted(table_of("point"), lambda state, view: StateObservation(state.name != "spin up"))
    done = finished(bench, ASKED["point"], table, controls, tmp_path)
    assert isinstance(done, NotReached)
    assert str(done) == "what was waited for"
    assert bench.logs == []
    assert not bench.turning


def test_locks_that_do_not_close_after_an_abort_are_a_warning_and_otherwise_an_error(tmp_path: Path) -> None:
    for aborted in (True, False):
        controls, bench = Controls(), Bench(RIG)

        def look(
            state: State, view: StateView, bench: Bench = bench, controls: Controls = controls
        ) -> StateObservation:
            if state.name == "swing":
                bench.fails_at = len(bench.commands) + 3  # the log's end, rest, lock
            if state.name == "swing" and aborted:  # noqa: B023 (used within this turn)
                controls.abort("smoke")
            return StateObservation(not (state.name == "swing" and aborted))  # noqa: B023

        done = finished(bench, ASKED["spin-down"], scripted(table_of("spin-down"), look), controls, tmp_path)
        if aborted:
            assert isinstance(done, TestDone)
            assert done.warnings == ("the pendulums are not locked: lock failed",)
        else:
            assert isinstance(done, DeviceError)


def test_a_pause_stops_the_clock_of_the_limit_and_interlocks_go_on(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    seen: list[str] = []
    looks: list[int] = []

    def slept() -> None:
        if controls.status.paused:
            seen.append(controls.status.state)
            bench.clock.ns += 3600 * 10**9
            controls.resume() if len(seen) == 3 else None

    bench.clock.does = slept

    def look(state: State, view: StateView) -> StateObservation:
        if state.name != "pluck":
            return StateObservation(True)
        looks.append(view.now_ns)
        if not seen:
            controls.pause()
        return StateObservation(len(looks) == 3)

    done = reached_its_log(bench, ASKED["ring-down-x"], scripted(table_of("ring-down-x"), look), controls, tmp_path)
    assert done.missed == ""
    assert seen == ["pluck"] * 3


def test_a_fault_ends_a_pause(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)

    def look(state: State, view: StateView) -> StateObservation:
        if state.name == "steady orbit":
            controls.pause()
        return StateObservation(state.name != "steady orbit")

    def slept() -> None:
        assert bench.clock.ns < start_ns + 10**13
        if controls.status.paused:
            bench.fault = DeviceError("laser/x: silent")

    start_ns, bench.clock.does = bench.clock.ns, slept
    done = finished(bench, ASKED["point"], scripted(table_of("point"), look), controls, tmp_path)
    assert str(done) == "laser/x: silent"
    assert bench.commands[-1] == "quick stop"


def test_a_pause_in_motion_is_answered_and_takes_effect_where_the_rig_may_wait(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    answers: list[str] = []
    paused: list[str] = []

    def slept() -> None:
        answers.append(controls.status.answer)
        if controls.status.paused:
            paused.append(controls.status.state)
            controls.resume()

    bench.clock.does = slept

    def look(state: State, view: StateView) -> StateObservation:
        if state.name == "spin up" and not answers:
            controls.pause()
            return StateObservation(False)
        return StateObservation(not (state.name == "spin up" and len(answers) < 2))

    finished(bench, ASKED["point"], scripted(table_of("point"), look), controls, tmp_path)
    assert any(answer.startswith("no pause here: the rotor passes through resonances") for answer in answers)
    assert paused[:1] == ["steady orbit"]


def test_notes_stand_in_the_log_with_their_time_also_those_made_before_it_begins(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    controls.note("before")

    def look(state: State, view: StateView) -> StateObservation:
        if state.name == "ring" and view.in_state_s == 0:
            controls.note("while it rings")
        return StateObservation(state.name != "ring" or view.in_state_s > 0)

    start_ns = bench.clock.ns
    finished(bench, ASKED["ring-down-x"], scripted(table_of("ring-down-x"), look), controls, tmp_path)
    assert [(event.kind, event.text) for event in bench.notes] == [("note", "before"), ("note", "while it rings")]
    assert bench.notes[0].facts["time_ns"] == start_ns
    assert bench.notes[1].facts["time_ns"] > start_ns


def test_a_table_with_a_transition_to_nowhere_is_refused() -> None:
    with pytest.raises(ValueError, match=r"a: done leads to 'b'; expected one of a, finish"):
        StateTable((State("a", done="b"),), (FINISH,))
    with pytest.raises(ValueError, match="different names"):
        StateTable((State("a"), State("a")), (FINISH,))


def test_commands_that_would_turn_unlocked_or_release_at_rest_are_refused(tmp_path: Path) -> None:
    kind = ASKED["point"].kind
    for name, wrong in (("turn", "not locked"), ("release", "not released")):
        command = {
            "turn": lambda commands: commands.turn(100.0, 10.0),
            "release": lambda commands: commands.release(True),
        }[name]
        opened = State("open", enter=lambda commands: commands.locks.release(False))
        unlocked = State("unlocked", enter=lambda commands: setattr(commands, "_held", False))
        bench, asked_ = Bench(RIG), GuidedTestRequest(RIG, kind, "point-B", "B", ASKED["point"].numbers)
        table = framed(asked_, opened, unlocked, State(name, enter=command))
        assert wrong in str(finished(bench, asked_, table, Controls(), tmp_path))
        assert bench.wrong == []


@pytest.mark.parametrize("before_s", [0.0, 2.0])
def test_a_log_with_a_pre_trigger_begins_when_the_motion_was_seen(before_s: float, tmp_path: Path) -> None:
    for name, motion in (("ring-down-x", "pluck x"), ("spin-down", "flick")):
        wanted = requested_test(RIG, name, {"pre_trigger_s": before_s})
        controls, bench = Controls(), Bench(RIG)
        table = scripted(wanted.kind.table(wanted), lambda state, view: StateObservation(True))
        reached_its_log(bench, wanted, table, controls, tmp_path)
        after = bench.commands.index("begin the log") > bench.commands.index(motion)
        assert after is (before_s > 0)


def test_the_operators_commands_are_the_same_where_no_device_turns_the_rotor() -> None:
    for name in KINDS:
        numbers = {"speed_rpm": 288.0} if name == "start-ups" else {}
        by_hand = requested_test(HAND, "point-B" if name == "point" else name, numbers)
        rows, hands = table_of(name).rows, by_hand.kind.table(by_hand).rows
        assert [row.name for row in rows] == [row.name for row in hands]
        assert all(
            row.asks for row in hands if row.actor in ("rotor", "locks") and row.name not in ("begin", "make ready")
        ), name


def test_a_start_up_from_rest_releases_before_the_rotor_turns(tmp_path: Path) -> None:
    controls, bench = Controls(), Bench(RIG)
    table = scripted(table_of(FROM_REST), lambda state, view: StateObservation(True))
    finished(bench, ASKED[FROM_REST], table, controls, tmp_path)
    assert bench.wrong == []
    expected = ["begin the log", "release", "scatter", "turn at 288 rpm"]
    assert [text for text in bench.commands if text in expected] == expected


@pytest.mark.parametrize(("state", "runs"), [("settle", 2), ("spin up", 1)])
def test_an_abort_ends_a_series_and_keeps_the_runs_before_it(
    state: str, runs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DrivenRotor", "CommandedLocks"):
        monkeypatch.setattr(f"daq.guided_tests.commands.{name}", lambda bench, *_: bench)
    bench, wanted, seen = Bench(RIG), ASKED["start-ups"], list[str]()

    def look(row: State, view: StateView) -> StateObservation:
        seen.append(row.name)
        if row.name == state and seen.count(state) == 2:
            tests.controls.abort("enough")
            return StateObservation(False)
        return StateObservation(True)

    tests = Procedures(bench, bench, tmp_path, lambda text, share: None)
    kind = replace(wanted.kind, table=lambda asked: scripted(wanted.kind.table(asked), look))
    done = tests.carry_out(replace(wanted, kind=kind))
    assert (len(done.runs), done.aborted) == (runs, True)
    assert done.missed == f"aborted by the operator in {state!r}: enough"
    assert [log["run"] for log in bench.logs] == ["1 of 20", "2 of 20"][:runs]
    assert bench.locked
    assert not bench.turning


SETTLE = next(row for row in table_of("point").rows if row.name == "settle")
SLOWEST = math.inf  # s until it is steady: never
AT_MOST_S = SETTLE.limit_s + SETTLE.extension_s


@pytest.mark.parametrize(
    ("steady_s", "reached", "waited_s", "contradicted_s"),
    [
        (20.0, True, 22.5, ()),
        (95.0, True, 97.5, ()),
        (140.0, True, 142.5, ()),
        (155.0, False, 92.5, ()),
        (SLOWEST, False, 92.5, ()),
        (110.0, True, 112.5, (95.0, 98.0)),  # as by a clock that was corrected
        (110.0, False, 100.0, (95.0, 105.0)),
        (-1.0, False, AT_MOST_S, ()),  # always nearly steady: the extension ends too
    ],
)
def test_a_point_that_is_nearly_steady_at_its_limit_gets_the_time_it_needs(
    steady_s: float, reached: bool, waited_s: float, contradicted_s: tuple[float, ...], tmp_path: Path
) -> None:
    bench, waited = Bench(RIG), 0.0

    class Approaching:
        """What a rig shows that approaches its steady state at a known rate."""

        def steady(self, since_ns: int, *_: object) -> Settling:
            since_s = (bench.clock.ns - since_ns) * 1e-9
            left_s = steady_s - since_s
            contradicted = bool(contradicted_s) and contradicted_s[0] < since_s < contradicted_s[1]
            bounded = math.isfinite(left_s) and not contradicted
            remaining = 3e-6 if bounded else math.inf
            facts = {"drift_rad": 0.0, "remaining_rad": 0.0, "drift_m": 0.0, "remaining_m": remaining}
            facts |= {"span_s": 9.0, "more_s": max(0.0, left_s)}
            return Settling(left_s <= 0, False, "it changes", **facts, approaching=bounded and left_s > 0)

    def look(state: State, view: StateView) -> StateObservation:
        nonlocal waited
        if state.name != "settle":
            return StateObservation(True)
        waited = view.in_state_s
        if steady_s < 0:
            return StateObservation(False, near=True)
        return SETTLE.look(replace(view, measures=cast("Measures", Approaching())))

    played = scripted(table_of("point"), look, looks=185)
    done = reached_its_log(bench, ASKED["point"], played, Controls(), tmp_path)
    assert done.missed == ("" if reached else "what was waited for")
    assert waited == pytest.approx(waited_s, abs=1.1)


def test_a_missed_steady_state_is_reported_with_the_duration_of_the_wait() -> None:
    view = StateView(cast("Measures", None), 0, 0, 0, 300.0, {})
    for waited_s, words in ((93.0, "within 90 s"), (120.5, "within 118 s"), (152.6, "within 150 s")):
        assert f"the steady state {words} of the release" in SETTLE.missed(replace(view, now_ns=int(waited_s * 1e9)))
