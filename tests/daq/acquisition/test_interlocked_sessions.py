"""Sessions on a virtual rig with faults: the rotor is stopped, operator and log get the reason."""

from __future__ import annotations

import json
import math
import sys
import threading
from pathlib import Path

import pytest

from daq.acquisition.session import Session
from daq.drivers.cia402 import wire as cia402
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.simulated import VirtualRigProcess
from rig_configs.schema import Rig
from tests.daq.simulated_sessions import quiet, turn


def only_log(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def summary_of(path: Path) -> dict[str, object]:
    with open_log(path) as log:
        return {key: json.loads(text) for key, text in log.metadata["summary"].items()}


def test_a_clean_end_leaves_the_drive_unwatched_and_no_emergency(simulated: LockstepRig, cabled: Rig) -> None:
    before = simulated.ask("state")["emergencies"]
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        turn(session, 300)
        assert simulated.ask("state")["watchdog_ms"] >= 500
    state = simulated.ask("state")
    assert (state["watchdog_ms"], state["drive"]) == (0, cia402.SWITCH_ON_DISABLED)
    assert state["speed_rpm"] < 0.5
    simulated.clock.wait(5.0)
    assert simulated.ask("state")["emergencies"] == before
    assert session.notices == []


def test_a_drive_that_restarts_is_named_at_once(simulated: LockstepRig, cabled: Rig, tmp_path: Path) -> None:
    restarted = r"drive: the drive started again \(boot-up"
    with pytest.raises(DeviceError, match=restarted), Session(cabled, simulated.clock, edge=simulated.edge) as session:  # noqa: PT012
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        turn(session, 300)
        simulated.ask("fail", device="drive", what="restart")
        try:
            session.rotor.wait_for_rest(30.0)
        finally:
            assert math.isnan(session.drive.actual_rpm)
            assert session.drive.state == cia402.UNKNOWN
    assert "the drive started again" in str(summary_of(tmp_path / "a.mcap")["ended"])
    assert simulated.ask("state")["speed_rpm"] < 0.5  # the session waited until the rotor had run down
    with open_log(tmp_path / "a.mcap") as log:
        assert [e["device"] for e in log.events if e["kind"] == "restart"] == ["drive"]


def test_a_lone_emergency_is_reported_and_kept(simulated: LockstepRig, cabled: Rig, tmp_path: Path) -> None:
    messages: list[str] = []
    with Session(cabled, simulated.clock, edge=simulated.edge, notify=messages.append) as session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        simulated.ask("fail", device="drive", what="emergency", value=0x3220)
        session.wait_for(lambda: any("0x3220" in notice for notice in session.notices), 5.0, "the emergency")
        session.check()  # the run continues
        simulated.ask("fail", device="drive", what="emergency", value=0)
        session.wait_for(lambda: not session.drive.emergencies, 5.0, "the error reset")
        path = session.stop_recording({})
    # a host that is too busy to send its heartbeat in time reports 0x8130
    ours = [words for words in messages if "0x8130" not in words]
    assert ours == ["warning: drive: emergency 0x3220, DC link under-voltage. The run is not clean"]
    assert summary_of(path)["warnings"] == session.notices
    assert summary_of(path)["ended"] == "the test's end"


def test_a_rotor_that_still_turns_at_the_end_is_reported(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daq.drivers.ramp._MAX_RUN_DOWN_S", 1.0)
    messages: list[str] = []
    still = "the rotor still turns"
    with (  # noqa: PT012
        pytest.raises(DeviceError, match=still),
        Session(cabled, simulated.clock, edge=simulated.edge, notify=messages.append) as session,
    ):
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        turn(session, 300)
        simulated.ask("fail", device="drive", what="fault", value=0x3220)  # without torque the rotor coasts
    assert simulated.ask("state")["watchdog_ms"] > 0
    assert still in str(summary_of(tmp_path / "a.mcap")["ended"])
    assert any(still in text for text in messages)


@pytest.mark.parametrize(
    ("stop", "words"),
    [(KeyboardInterrupt(), "Ctrl-C"), (KeyboardInterrupt("SIGTERM"), "SIGTERM"), (ValueError("x"), "ValueError: x")],
)
def test_the_log_contains_what_ended_it(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path, stop: BaseException, words: str
) -> None:
    with pytest.raises(type(stop)), Session(cabled, simulated.clock, edge=simulated.edge) as session:  # noqa: PT012
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        raise stop
    assert summary_of(tmp_path / "a.mcap")["ended"] == words


def test_a_rotor_that_is_blind_to_a_laser_is_not_turned(simulated: LockstepRig, cabled: Rig) -> None:
    try:
        with Session(cabled, simulated.clock, edge=simulated.edge) as session:
            simulated.ask("fail", device="laser_x", what="code", value=262076)
            session.clock.wait(1.0)
            with pytest.raises(DeviceError, match="not turned: laser/x: most samples"):
                session.drive.enable()
            with pytest.raises(ProcedureError, match="5000 rpm requested"):
                session.drive.set_speed(5000)
            assert simulated.ask("state")["drive"] != cia402.OPERATION_ENABLED
    finally:
        simulated.ask("fail", device="laser_x", what="code", value=0)


@pytest.mark.skipif(sys.platform == "win32", reason="threads that wait in real time, on ptys")
def test_a_quick_stop_waits_for_neither_log_nor_decoder(
    virtual_rig: VirtualRigProcess, plugged: Rig, tmp_path: Path
) -> None:
    with Session(plugged, virtual_rig.clock) as session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        turn(session, 300)
        recorder = session.recording.recorder
        held, released = threading.Event(), threading.Event()

        def hold() -> None:
            with recorder._lock, session._links.unread("drive"):
                held.set()
                released.wait(20)

        holder = threading.Thread(target=hold)
        holder.start()
        held.wait()
        stopping = threading.Thread(target=session.drive.quick_stop)
        stopping.start()
        stopping.join(10)
        waited = stopping.is_alive()
        while not waited and virtual_rig.line.ask("state")["speed_rpm"] > 0.5:
            threading.Event().wait(0.01)
        released.set()
        holder.join()
        stopping.join()
        session.wait_for(lambda: session.rotor.at_rest() is True, 5.0, "rest")
        path = session.stop_recording({})
    assert not waited
    with open_log(path) as log:
        written = [(c.direction, c.host_ns, c.data) for c in log.raw("drive")]
    quick = cia402.VELOCITY.pack(cia402.QUICK_STOP, 0)
    assert any(direction == 1 and quick in data for direction, _, data in written)
    assert [ns for _, ns, _ in written] == sorted(ns for _, ns, _ in written)  # rx and tx as they were
    assert [row.topic for row in check(path) if row.difference] == []


def test_a_faulty_encoder_is_refused_at_the_locks_and_ends_a_test_that_needs_it(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    class Breaks(SimulatedOperator):
        """The operator who flicks the pendulums also hits B's encoder."""

        def flick(self) -> None:
            super().flick()
            simulated.ask("fail", device="encoder", what="flags", value=2)

    try:
        with (
            pytest.raises(
                (ProcedureError, DeviceError), match="fault of encoder B"
            ),  # by the test's own look, or a tick
            Session(cabled, simulated.clock, edge=simulated.edge) as session,
        ):
            Procedures(session, Breaks(simulated), tmp_path, quiet).spin_down()
        assert "fault of encoder B" in str(summary_of(only_log(tmp_path))["ended"])
        simulated.ask("fail", device="encoder", what="flags", value=1)
        with Session(cabled, simulated.clock, edge=simulated.edge) as session:
            tests = Procedures(session, Breaks(simulated), tmp_path, quiet)
            for test in (tests.spin_down, lambda: tests.point("A", 15.0), lambda: tests.run_up(600.0, 10.0)):
                with pytest.raises(ProcedureError, match=r"fault of encoder A: .*Nothing was turned"):
                    test()
        assert len(list(tmp_path.glob("*.mcap*"))) == 1
    finally:
        simulated.ask("fail", device="encoder", what="flags", value=0)
