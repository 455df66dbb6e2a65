"""Rigs that the operator turns and locks by hand, and rigs with few devices: sessions on simulated rigs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.acquisition.device_check import device_checks
from daq.acquisition.interlocks import Interlocks
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.observation import observe
from daq.acquisition.session import Session
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.hands import SEEN_RAD, release_time
from daq.guided_tests.procedure import Procedures, zero_counters
from daq.lockstep.rig import LockstepRig
from daq.replay import check
from daq.signals.run import load_run
from daq.virtual_rig.simulated_operator import SimulatedOperator
from identification import NotIdentifiable, identify
from identification.pendulums.release import fit_release
from identification.pendulums.suspension_knowledge import Knowledge
from rig_configs import load_rig
from rig_configs.schema import Rig
from tests.daq.far_ends import START_NS
from tests.daq.simulated_sessions import quiet


def simulated(name: str) -> tuple[LockstepRig, Rig]:
    process = LockstepRig(load_rig(name, settings=["virtual.seed=3"]))
    return process, load_rig(name, settings=process.port_settings())


@pytest.fixture
def one() -> tuple[LockstepRig, Rig]:
    return simulated("one_laser")


@pytest.fixture
def hand() -> tuple[LockstepRig, Rig]:
    return simulated("by_hand")


def test_one_laser_is_checked_rings_down_and_is_identified(one: tuple[LockstepRig, Rig], tmp_path: Path) -> None:
    process, rig = one
    with Session(rig, process.clock, edge=process.edge) as session:
        checks = device_checks(rig, observe(session, 0.5))
        assert list(checks) == ["probe"]
        assert [what for what, found in checks["probe"].items() if found.failed] == []
        tests = Procedures(session, SimulatedOperator(process), tmp_path, quiet)
        with pytest.raises(ProcedureError, match="spin-down needs pendulum angles"):
            tests.spin_down()
        with pytest.raises(DeviceError, match="no locks that can be commanded"):
            zero_counters(session)
        with pytest.raises(DeviceError, match="no open speed source"):
            _ = session.drive
        done = tests.ring_down("x")
    assert done.missed == ""
    assert [row.topic for row in check(done.log) if row.difference] == []
    found = identify([load_run(done.log)], rig).parameters
    truth = rig.true_physics.identified()
    assert all(abs(found.values[name] - truth[name]) < 4 * found.std[name] for name in ("k1_N_per_m", "zeta1"))


def test_pendulums_are_locked_released_and_flicked_by_hand(hand: tuple[LockstepRig, Rig], tmp_path: Path) -> None:
    process, rig = hand
    with Session(rig, process.clock, edge=process.edge) as session:
        done = Procedures(session, SimulatedOperator(process), tmp_path, quiet).spin_down()
    run = load_run(done.log)
    assert (done.missed, done.warnings) == ("", ())
    assert np.all(np.ptp(run.angle_rad, axis=0) > 2.0)
    assert session.notices == []


@pytest.mark.lengthy
def test_the_rotor_is_turned_and_the_pendulums_released_by_hand(hand: tuple[LockstepRig, Rig], tmp_path: Path) -> None:
    process, rig = hand
    messages: list[str] = []
    with Session(rig, process.clock, edge=process.edge, notify=messages.append) as session:
        tests = Procedures(session, SimulatedOperator(process), tmp_path, quiet)
        done = tests.point("B", rig.physics.speed_rad_s(1.6))
    run = load_run(done.log)
    assert done.missed == ""
    assert [(r.pendulum, r.time_std_s >= 0.03) for r in run.releases] == [(0, True), (1, True)]
    moved = np.ptp(run.angle_rad[run.angle_time_s < run.releases[0].time_s - 3 * run.releases[0].time_std_s], axis=0)
    assert np.all(moved < 2 * SEEN_RAD)  # they were held until then
    with pytest.raises(NotIdentifiable, match="release by hand"):
        fit_release(run, Knowledge.nominal(rig.physics), 0.001)
    assert [row.topic for row in check(done.log) if row.difference] == []
    assert messages == []


def test_an_operator_who_turns_too_fast_is_instructed_to_stop(hand: tuple[LockstepRig, Rig], tmp_path: Path) -> None:
    process, rig = hand
    messages: list[str] = []

    class Hasty(SimulatedOperator):
        def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
            super().turn(2.5 * rpm, 400.0)

    words = r"index marks come at .* rpm, limits.speed_rpm is 1200; stop the rotor"
    session = Session(rig, process.clock, edge=process.edge, notify=messages.append)
    with pytest.raises(ProcedureError, match=words), session:
        Procedures(session, Hasty(process), tmp_path, quiet).run_up(900.0, 40.0)
    (stop,) = [text for text in messages if "STOP THE ROTOR: the index marks" in text]
    assert "stop the rotor" not in stop
    session = Session(rig, process.clock, edge=process.edge)
    with pytest.raises(ProcedureError, match="nothing was turned"), session:
        Procedures(session, SimulatedOperator(process), tmp_path, quiet).run_up(1300.0, 40.0)


def test_a_failed_index_sensor_is_not_taken_for_rest(hand: tuple[LockstepRig, Rig], tmp_path: Path) -> None:
    process, rig = hand
    messages: list[str] = []

    def fails() -> None:
        process.ask("fail", device="encoder", what="marks lost")

    class Unlucky(SimulatedOperator):
        def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
            super().turn(rpm, ramp_rpm_per_s)
            if rpm > 0:
                process.clock.after(7.5, fails, world=True)

    session = Session(rig, process.clock, edge=process.edge, notify=messages.append)
    with pytest.raises(DeviceError, match=r"tacho: no index mark for .* no other device measures"), session:
        Procedures(session, Unlucky(process), tmp_path, quiet).run_up(900.0, 40.0)
    assert any("STOP THE ROTOR: tacho" in text for text in messages)
    assert any("the rotor still turns" in text and "keep away" in text for text in messages)


def test_a_covered_laser_does_not_end_a_recording_without_a_commanded_speed() -> None:
    rig = load_rig("one_laser")
    interlocks = Interlocks(rig.limits, rig.roles, LeastMotion.of(rig), driving=True)
    interlocks.begin(START_NS)
    assert interlocks.at_rest(START_NS) is None
    assert not interlocks.turning(START_NS)
    interlocks.commanded(100.0)  # a test asks the operator to turn it
    assert interlocks.turning(START_NS)


def test_other_makers_devices_record_turn_and_replay(tmp_path: Path) -> None:
    process, rig = simulated("other_devices")
    with Session(rig, process.clock, edge=process.edge) as session:
        tests = Procedures(session, SimulatedOperator(process), tmp_path, quiet)
        done = [tests.ring_down("y"), tests.run_down(600.0, 20.0)]
    for each in done:
        assert each.missed == ""
        rows = {row.topic: row for row in check(each.log)}
        assert [topic for topic, row in rows.items() if row.difference] == []
        assert all(rows[topic].live > 0 for topic in ("laser/x", "laser/y", "pendulums", "motor"))
        assert json.loads(load_run(each.log).metadata["identities"]["east"]["serial"]) == 19001


@given(st.floats(0.5, 40.0), st.floats(0.0, 0.5), st.floats(-0.9, 0.9))
def test_the_time_of_a_release_lies_within_its_uncertainty(torque: float, at: float, jerk: float) -> None:
    """A pendulum starts from rest under a torque that changes by up to 90 % until its motion is detected."""
    time = np.arange(0.0, at + 3.0, 0.001)
    since = np.maximum(time - at, 0.0)
    reach = np.sqrt(2 * 4 * SEEN_RAD / torque)  # about when the angle has grown to where it is looked at last
    moved = 0.5 * torque * since**2 * (1 + jerk * since / (3 * reach))
    found, std = release_time(time, np.column_stack([moved, 0.1 * moved]))
    assert abs(found - at) < 2 * std
