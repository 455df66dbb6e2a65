"""Life of a session: the transitions of its table, and its stages on a simulated rig."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from daq.acquisition.life import LISTENING, TRANSITIONS, Life, Stage, Step, guarded
from daq.acquisition.session import Session
from daq.errors import AcquisitionError, OperatorStop
from daq.transports import HostClock
from rig_configs import load_rig
from tests.daq.simulated_sessions import opened


@given(st.lists(st.sampled_from(Step), max_size=20))
def test_a_step_leads_to_its_stage_or_is_refused_without_a_change(steps: list[Step]) -> None:
    life = Life()
    for step in steps:
        before = life.stage
        if (before, step) in TRANSITIONS:
            assert life.go(step) is before
            assert life.stage is TRANSITIONS[before, step]
        else:
            with pytest.raises(AcquisitionError, match=f"the session is {before}, and cannot {step}"):
                life.go(step)
            assert life.stage is before


def test_every_stage_can_be_closed_and_only_a_closed_one_is_final() -> None:
    for stage in Stage:
        possible = {step for left, step in TRANSITIONS if left is stage}
        assert (Step.CLOSE in possible) is (stage is not Stage.CLOSED)
        assert bool(possible) is (stage is not Stage.CLOSED)
    assert TRANSITIONS[Stage.STOPPING, Step.FINISH] is Stage.CLOSED


def test_the_interlocks_are_active_exactly_between_the_opening_and_the_stop() -> None:
    assert {stage for stage in Stage if guarded(stage)} == {Stage.WATCHING, Stage.RECORDING}
    entered = {left for (left, _), stage in TRANSITIONS.items() if guarded(stage) and not guarded(left)}
    assert entered == {Stage.OPENING, Stage.STARTING}


def test_a_session_that_is_not_open_begins_and_ends_no_log(tmp_path: Path) -> None:
    session = Session(load_rig("virtual"), HostClock())
    with pytest.raises(AcquisitionError, match="the session is new, and cannot begin a log; possible now: open"):
        session.start_recording(tmp_path / "a.mcap", {})
    session.close()
    with pytest.raises(AcquisitionError, match="the session is closed, and cannot end a log; possible now: nothing"):
        session.stop_recording({})
    assert session.closed
    assert list(tmp_path.iterdir()) == []


def test_the_policy_decides_how_a_session_begins(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="needs the policy"):
        Session(load_rig("virtual"), HostClock()).listen(tmp_path / "a.mcap", {})
    with pytest.raises(ValueError, match="begins with `listen`"):
        Session(load_rig("virtual"), HostClock(), policy=LISTENING).open()


def test_a_session_watches_records_and_closes(tmp_path: Path) -> None:
    _, session = opened("virtual")
    stages = [session.life.stage]
    with session:
        stages.append(session.life.stage)
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        stages.append(session.life.stage)
        session.stop_recording({})
        stages.append(session.life.stage)
    stages.append(session.life.stage)
    assert stages == [Stage.NEW, Stage.WATCHING, Stage.RECORDING, Stage.WATCHING, Stage.CLOSED]


def test_a_requested_stop_is_carried_out_by_the_next_check() -> None:
    _, session = opened("virtual")
    with pytest.raises(OperatorStop, match="enough"), session:  # noqa: PT012
        session.request_stop("enough")
        assert session.trouble is None
        session.check()
    assert session.closed
