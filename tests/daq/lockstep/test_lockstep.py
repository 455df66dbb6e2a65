"""Whole sessions in one thread on simulated time: repeatable bit for bit, and correct under faults."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.acquisition.session import Session
from daq.clock import ClockMap
from daq.drivers.registry import driver
from daq.errors import AcquisitionError, DeviceError, LinkLost
from daq.guided_tests.procedure import Procedures
from daq.lockstep.clock import SimulatedClock, WaitNeverEnds
from daq.lockstep.rig import STEP_S, LockstepRig
from daq.log import open_log
from daq.log.losses import losses_of
from daq.replay import check
from daq.signals.run import load_run
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_configs import load_rig
from rig_testing.fault_schedules import Schedule, ScheduledFault, draw, run
from tests.daq import simulated_sessions
from tests.daq.simulated_sessions import guided, quiet, recording
from tests.effort import cases, thorough

SHIPPED = ("virtual", "other_devices", "by_hand", "one_laser", "ethernet_lasers", "analogue_lasers", "can_lasers")


def opened(rig: str) -> tuple[LockstepRig, Session]:
    return simulated_sessions.opened(rig, "virtual.seed=5")


# --- the clock ---------------------------------------------------------------------------------------------------


def test_actions_run_in_order_and_only_during_waits() -> None:
    clock, done = SimulatedClock(), []
    for seconds in (0.3, 0.1, 0.2, 0.1):
        clock.after(seconds, lambda s=seconds: done.append((s, round(clock.now_s(), 3))))
    assert done == []
    clock.wait(0.25)
    assert done == [(0.1, 0.1), (0.1, 0.1), (0.2, 0.2)]
    assert clock.now_s() == 0.25


def test_actions_of_a_busy_host_are_delayed_and_those_of_the_world_are_not() -> None:
    clock, done = SimulatedClock(), []
    clock.after(0.1, lambda: done.append(("host", clock.now_s())))
    clock.after(0.2, lambda: done.append(("world", clock.now_s())), world=True)
    clock.busy(0.5)
    clock.wait(0.05)
    assert done == [("world", 0.2), ("host", 0.5)]
    assert clock.now_s() >= 0.5  # who waits wakes up when the host does


def test_an_interruption_ends_a_wait_after_the_action() -> None:
    """An action is whole: a recorder that is interrupted in the middle could not end its log."""
    clock, done = SimulatedClock(), list[str]()

    def interrupted() -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("first")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests may run with an ignored Ctrl-C
    try:
        clock.after(1.0, interrupted)
        clock.after(2.0, lambda: done.append("second"))
        with pytest.raises(KeyboardInterrupt):
            clock.wait(10.0)
        assert (done, clock.now_s()) == (["first"], 1.0)
        seen = list[int]()
        signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
        clock.after(0.0, interrupted)
        clock.wait(10.0)
        assert (done, clock.now_s(), seen) == (["first", "first", "second"], 11.0, [signal.SIGINT])
    finally:
        signal.signal(signal.SIGINT, before)


def test_actions_must_not_wait() -> None:
    clock = SimulatedClock()
    clock.after(0.1, lambda: clock.wait(1.0))
    with pytest.raises(WaitNeverEnds):
        clock.wait(1.0)


def test_a_repeated_action_ends_with_its_first_failure() -> None:
    clock, times, failures = SimulatedClock(), [], []

    def do() -> None:
        times.append(round(clock.now_s(), 3))
        if len(times) == 3:
            raise OSError("gone")

    clock.every(0.1, do, "x", failures.append)
    clock.wait(1.0)
    assert times == [0.1, 0.2, 0.3]
    assert [str(each) for each in failures] == ["gone"]


# --- a session ---------------------------------------------------------------------------------------------------


def test_two_processes_record_the_same_bytes(tmp_path: Path) -> None:
    """The order of hashes of strings differs between processes."""
    digests = set()
    for number in ("1", "2"):
        code = f"""
import hashlib, sys
from pathlib import Path
from rig_testing.fault_schedules import draw, run
from rig_configs import load_rig
seed = next(seed for seed in range(1000) if len(draw(load_rig("virtual"), seed).faults) == 3)
print(run("virtual", draw(load_rig("virtual"), seed), Path({str(tmp_path / number)!r})).digest)
"""
        (tmp_path / number).mkdir()
        environment = {**os.environ, "PYTHONHASHSEED": number}
        found = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
        )
        digests.add(found.stdout.strip())
    assert len(digests) == 1
    assert len(digests.pop()) == 64


@pytest.mark.parametrize("rig", SHIPPED)
def test_every_shipped_rig_is_recorded_as_in_real_time(rig: str, tmp_path: Path) -> None:
    sim, session = opened(rig)
    with recording(session, tmp_path / "a.mcap"):
        sim.clock.wait(3.0)
        session.check()
    assert session.notices == []
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []
    with open_log(tmp_path / "a.mcap") as log:
        for topic in session.channels.topics:
            times = log[topic].time_ns
            assert (times[-1] - times[0]) * 1e-9 == pytest.approx(3.0, abs=0.5), topic


def test_samples_that_wait_behind_a_gap_are_in_a_log_that_ends_meanwhile(tmp_path: Path) -> None:
    sim, session = opened("other_devices")
    with recording(session, tmp_path / "a.mcap"):
        sim.clock.wait(4.0)
        sim.ask("fail", device="east", what="mute", value=1, seconds=0.3)
        sim.clock.wait(0.4)
        end_ns = sim.clock.now_ns()
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []
    with open_log(tmp_path / "a.mcap") as log:
        times = log["laser/x"].time_ns
        assert (end_ns - times[-1]) * 1e-9 < STEP_S[1] + 0.03
        assert np.sum(np.diff(times) > 0.25e9) == 1
        lost = [event["samples"] for event in log.events if event["kind"] == "gap" and event["device"] == "east"]
    assert sum(lost) == pytest.approx(0.3 * 4000, abs=12)


def test_a_pre_trigger_holds_the_seconds_before_the_pluck(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    with session:
        tests = guided(session, sim, tmp_path)
        done = tests.run("ring-down-x", pre_trigger_s=1.5)
    assert done.missed == ""
    assert [row.topic for row in check(done.log) if row.difference] == []
    with open_log(done.log) as log:
        x = log["laser/x"]
        moved = abs(x["displacement_m"] - x["displacement_m"][:200].mean()) > 3e-4
        first = int(moved.argmax())
        assert moved.any()
        assert (x.time_ns[first] - x.time_ns[0]) * 1e-9 == pytest.approx(1.5, abs=0.15)
        assert log.metadata["summary"]["losses"].count('"samples": 0') >= 2


@pytest.mark.parametrize("rig", ["virtual", "other_devices"])
def test_the_first_samples_of_a_log_are_timed_like_its_last_ones(rig: str, tmp_path: Path) -> None:
    """The clock states before the log are written to it, so that it decodes to the same times."""
    _, session = opened(rig)
    angles = session.rig.roles.angles
    assert angles is not None
    with session:
        wait_checking(session, 6.0)
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        wait_checking(session, 4.0)
        session.stop_recording({})
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []
    with open_log(tmp_path / "a.mcap") as log:
        assert set(json.loads(log.attachments["clocks.json"])) >= {angles.device}
        assert json.loads(log.attachments["identities.json"])[angles.device]["node"] == 1
        samples = log[angles.topic]
        lag_ms = 1e-6 * (samples.time_ns - 1000 * samples["node_time_us"].astype(np.int64))
        assert abs(lag_ms[:50].mean() - lag_ms[-1000:].mean()) < 1.0


class Hand(SimulatedOperator):
    """An operator who holds the column for some time, or brings it back to rest before the release."""

    def __init__(self, sim: LockstepRig, *holds: tuple[float, float]) -> None:
        super().__init__(sim)
        self._sim, self._holds = sim, holds

    def pluck(self, axis: str) -> None:
        begin = 0.0
        for x_mm, seconds in self._holds:
            pull = {"x_mm": x_mm, "y_mm": 0.0, "hold_s": seconds}
            self._sim.clock.after(begin, lambda pull=pull: self._sim.ask("pluck", **pull), world=True)
            begin += seconds


@pytest.mark.parametrize("seconds", [pytest.param(1.2, marks=thorough), 6.0, pytest.param(20.0, marks=thorough)])
def test_a_column_that_is_still_held_has_not_rung_down(seconds: float, tmp_path: Path) -> None:
    sim, session = opened("virtual")
    with session:
        done = Procedures(session, Hand(sim, (2.5, seconds)), tmp_path, quiet).run("ring-down-x")
    assert done.missed == ""
    run = load_run(done.log)
    held = run.x_time_s < run.x_time_s[-1] - 5.0
    assert run.x_m[held].max() > 2e-3
    assert abs(run.x_m[run.x_time_s > run.x_time_s[-1] - 0.5]).max() < 3e-4, "the log ends with a column at rest"


def test_a_column_that_was_brought_back_by_hand_has_not_rung_down(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    back = [(2.5 * (1 - step / 20), 0.05) for step in range(21)]
    words: list[str] = []
    with session:
        tests = Procedures(session, Hand(sim, *back), tmp_path, lambda text, share: words.append(text))
        done = tests.run("ring-down-x")
    assert "held, or brought back by hand" in done.missed
    assert any("returned without a swing" in text for text in words)


def test_a_ring_down_begins_with_a_column_at_rest(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    with session:
        sim.clock.wait(1.0)
        sim.ask("pluck", x_mm=4.0, y_mm=0.0, hold_s=0.2)
        sim.clock.wait(0.5)
        done = guided(session, sim, tmp_path).run("ring-down-x")
    run = load_run(done.log)
    assert np.ptp(run.x_m[run.x_time_s < run.x_time_s[0] + 0.6]) < 3.5e-4


# --- devices that go and come back -----------------------------------------------------------------------------------


def wait_checking(session: Session, seconds: float) -> None:
    """Wait as an operator does: an error ends the wait."""
    end = session.clock.now_s() + seconds
    while session.clock.now_s() < end:
        session.check()
        session.clock.wait(0.05)


def test_an_adapter_on_another_port_is_found_and_the_other_devices_continue(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    with recording(session, tmp_path / "a.mcap"):
        sim.clock.wait(1.0)
        sim.ask("unplug", device="laser_x")
        wait_checking(session, 3.0)
        sim.ask("plug", device="laser_x")
        wait_checking(session, 6.0)
    with open_log(tmp_path / "a.mcap") as log:
        kinds = [(event["kind"], event.get("of")) for event in log.events if event["kind"] in ("gone", "back")]
        assert kinds == [("gone", "laser_x"), ("back", "laser_x")]
        x, y = log["laser/x"].time_ns, log["laser/y"].time_ns
        assert (x[-1] - x[0]) * 1e-9 > 8.0
        assert max(x[1:] - x[:-1]) > 2.5e9
        assert max(y[1:] - y[:-1]) < 0.01e9
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []


def test_a_sensor_that_lost_power_is_set_up_again(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    with recording(session, tmp_path / "a.mcap"):
        sim.clock.wait(1.0)
        sim.ask("fail", device="laser_y", what="power", value=1, seconds=3.0)
        wait_checking(session, 15.0)
    with open_log(tmp_path / "a.mcap") as log:
        y = log["laser/y"].time_ns
        assert (log.end_ns - y[-1]) * 1e-9 < 0.2
        assert [event["kind"] for event in log.events if event.get("of") == "laser_y"][:2] == ["gap", "silent"] or any(
            event["kind"] == "silent" for event in log.events
        )


def _record_a_laser_with_another_serial_number(sim: LockstepRig, session: Session, log: Path) -> None:
    """Record while a laser is unplugged and plugged in again, whose known serial number is not its own."""
    with session:
        session.start_recording(log, {"test": "record"})
        session.identities["laser_x"]["serial"] = "another"
        sim.ask("unplug", device="laser_x")
        sim.clock.wait(0.5)
        sim.ask("plug", device="laser_x")
        wait_checking(session, 5.0)
        session.stop_recording({})


def test_another_device_on_the_cable_is_left_alone(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    _record_a_laser_with_another_serial_number(sim, session, tmp_path / "a.mcap")
    with open_log(tmp_path / "a.mcap") as log:
        refused = [event for event in log.events if event["kind"] == "other"]
        assert ["serial 14200001 instead of another" in event["text"] for event in refused] == [True], "reported once"
        assert not any(event["kind"] == "back" for event in log.events)
    assert any("instead of another" in notice for notice in session.notices)


def test_a_measured_value_is_no_other_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The signal of a radio and the lag of a beacon differ each time the device is opened."""
    assert driver("microstrain").measured == {"beacon_lag_ns"}
    assert driver("xbee").measured == {"rssi_dBm"}
    sim, session = opened("virtual")
    monkeypatch.setitem(vars(driver("optoncdt")), "measured", frozenset({"serial"}))
    _record_a_laser_with_another_serial_number(sim, session, tmp_path / "a.mcap")
    with open_log(tmp_path / "a.mcap") as log:
        assert any(event["kind"] == "back" for event in log.events)
        assert not any(event["kind"] == "other" for event in log.events)


def test_no_device_is_reopened_while_the_rotor_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dialogue with a device that was plugged in again would delay the monitoring of the rotor."""
    sim, session = opened("virtual")
    with recording(session, tmp_path / "a.mcap"):
        sim.ask("unplug", device="laser_x")
        sim.clock.wait(0.5)
        sim.ask("plug", device="laser_x")
        with monkeypatch.context() as turned:
            turned.setattr(type(session.rotor), "turning", lambda self: True)
            wait_checking(session, 6.0)
            assert list(session._core.gone) == ["laser_x"]
        wait_checking(session, 4.0)
        assert list(session._core.gone) == []


@pytest.mark.parametrize("back_s", [0.4, 2.5])
def test_a_rotor_that_runs_away_while_its_cable_is_out_is_stopped_once_it_is_back(back_s: float) -> None:
    """No watchdog stops a controller that turns without a command: the end of the session reopens its link."""
    sim, session = opened("other_devices")
    with pytest.raises(DeviceError, match="motor: silent"), session:  # noqa: PT012
        sim.ask("unplug", device="motor")
        sim.ask("fail", device="motor", what="speed", value=600.0)
        sim.clock.after(back_s, lambda: sim.ask("plug", device="motor"))
        session.wait_for(lambda: False, 5.0, "the trip")
    assert abs(sim.far.motion.speed_rad_s) < 0.2
    assert sim.far.motion.target_rad_s == 0.0


def test_a_turning_rotor_that_runs_away_while_its_cable_is_out_is_stopped_once_it_is_back() -> None:
    """The lost link ends the run, and is reopened nevertheless."""
    sim, session = opened("other_devices")
    with pytest.raises(LinkLost, match="motor: the other end closed"), session:  # noqa: PT012
        session.drive.enable()
        session.drive.set_speed(300.0)
        session.wait_for(lambda: abs(sim.far.motion.speed_rad_s) > 30.0, 10.0, "300 rpm")
        sim.ask("unplug", device="motor")
        sim.clock.after(0.8, lambda: sim.ask("fail", device="motor", what="speed", value=1000.0))
        sim.clock.after(2.0, lambda: sim.ask("plug", device="motor"))
        session.wait_for(lambda: False, 5.0, "the trip")
    assert abs(sim.far.motion.speed_rad_s) < 0.2
    assert sim.far.motion.target_rad_s == 0.0


@pytest.mark.parametrize(("rig", "drive"), [("virtual", "drive"), ("other_devices", "motor")])
def test_a_silent_drive_at_rest_is_reported_as_not_released_and_the_others_are_stopped(
    rig: str, drive: str, tmp_path: Path
) -> None:
    sim, session = opened(rig)
    stopped: list[str] = []
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        session.drive.enable()
        sim.ask("fail", device=drive, what="mute", value=1)
        stop_streams = session._links.stop_streams
        session._links.stop_streams = lambda: (stopped.append("streams"), stop_streams())
    assert stopped == ["streams"]
    assert session.rotor_warning == (
        f"{drive}: the rotor is at rest, but the drive may not have released it; check its power and cable"
    )
    assert session.rotor_warning in session.notices
    with open_log(tmp_path / "a.mcap") as log:
        assert "the drive may not have released it" in json.dumps(log.metadata)


# --- randomised faults ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", ["virtual", "other_devices"])
@pytest.mark.parametrize("block", range(cases(2, 4)))
def test_under_every_fault_schedule_the_log_is_correct_and_the_rotor_stops(
    rig: str, block: int, tmp_path: Path
) -> None:
    """Schedules by their seeds; `python -m benchmarks.fault_schedules` runs thousands."""
    known, each = load_rig(rig), cases(2, 25)
    for seed in range(each * block, each * (block + 1)):
        result = run(rig, draw(known, seed), tmp_path)
        assert result.wrong == [], (seed, result.schedule)


def test_a_run_without_faults_does_not_trip(tmp_path: Path) -> None:
    result = run("virtual", draw(load_rig("virtual"), 3, calm=True), tmp_path)
    assert (result.wrong, result.ended) == ([], "")


def test_the_judge_sees_a_sample_that_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bits of a line without a checksum are flipped after the judge's record."""
    schedule = Schedule(1, 0.0, 5.0, STEP_S, (ScheduledFault(1.0, 3.0, "laser_x", "bit errors", 1e-3),))
    honest = run("virtual", schedule, tmp_path)
    assert honest.wrong == []
    (tmp_path / "schedule-1.mcap").unlink()
    monkeypatch.setattr("rig_testing.fault_schedules._SPOILING", ())
    found = run("virtual", schedule, tmp_path)
    assert any("laser/x" in text or "laser_x" in text for text in found.wrong)


def test_the_judge_sees_early_times_of_a_wire_that_carries_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = ClockMap.map
    monkeypatch.setattr(ClockMap, "map", lambda *given, **more: plain(*given, **more) - 5_000_000)
    found = run("other_devices", Schedule(3, 300.0, 6.0, STEP_S, ()), tmp_path)
    assert any(text.startswith("laser/x: times are -") for text in found.wrong)


@pytest.mark.parametrize(("seed", "delay_s"), [(413, 0.0), (1674, 2.0)])
def test_the_judge_does_not_take_other_motion_for_early_times(seed: int, delay_s: float, tmp_path: Path) -> None:
    """Rounded readings of a rotor at rest that moves once; a laser perpendicular to a whirl along the other axis."""
    drawn = draw(load_rig("other_devices"), seed)
    later = [replace(fault, at_s=fault.at_s + delay_s) for fault in drawn.faults]
    result = run("other_devices", replace(drawn, faults=tuple(later)), tmp_path)
    assert result.wrong == []


@pytest.mark.skipif(sys.platform == "win32", reason="a busy host is a stopped process: POSIX signals")
@pytest.mark.parametrize(
    "fault",
    [
        ScheduledFault(1.5, 0.3, "", "busy"),
        pytest.param(ScheduledFault(1.5, 1.5, "encoder", "garbage", 200.0), marks=thorough),
        ScheduledFault(1.5, 0.8, "laser_y", "unplug"),
    ],
)
def test_the_same_faults_in_real_time(fault: ScheduledFault, tmp_path: Path) -> None:
    """`python -m benchmarks.fault_schedules --real-time` runs a hundred."""
    result = run("virtual", Schedule(5, 0.0, 5.0, STEP_S, (fault,)), tmp_path, real_time=True)
    assert (result.wrong, result.ended) == ([], "")


def test_the_judge_sees_a_rotor_that_is_not_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.acquisition.interlocks.Interlocks.tick", lambda self, now_ns: [])
    schedule = Schedule(2, 300.0, 8.0, STEP_S, (ScheduledFault(3.0, 4.0, "encoder", "radio", 1.0),))
    found = run("virtual", schedule, tmp_path)
    assert any("blind for" in text for text in found.wrong)


def _dies_in_the_spin_up(sim: LockstepRig, session: Session, folder: Path, messages: list[str]) -> None:
    """Spin up for a point, whose log begins later, until the encoder dies."""

    def dies(text: str, share: float | None) -> None:
        messages.append(text)
        if "spinning up" in text and share is not None and share > 0.5:
            sim.ask("fail", device="encoder", what="dead", value=1.0)

    with pytest.raises(DeviceError, match=r"pendulums: silent .*; the rotor was commanded to stop"), session:
        guided(session, sim, folder, dies).point("B", 500.0 * np.pi / 30)


def test_a_trip_during_the_spin_up_is_recorded_although_no_log_had_begun(tmp_path: Path) -> None:
    """The rotor passes both resonances before a point's log begins."""
    sim, session = opened("virtual")
    messages: list[str] = []
    _dies_in_the_spin_up(sim, session, tmp_path, messages)
    (path,) = tmp_path.glob("*.mcap")
    assert any(path.name in text and "no log had begun" in text for text in messages)
    assert not check(path).channels[0].difference
    with open_log(path) as log:
        assert "pendulums: silent" in json.loads(log.metadata["summary"]["ended"])
        (trip,) = [event for event in log.events if event["kind"] == "trip"]
        assert trip["interlocks"] == ["silent angles"]
        assert trip["speed_rpm"] == pytest.approx(log["motor"].speed_rpm.max(), rel=0.2)
        assert set(trip["excerpt"]) == {"laser/x", "laser/y", "motor"}, "the node was silent for a second"
        assert len(json.dumps(trip)) < 60_000
        silences = [event for event in log.events if event["kind"] == "silence" and event["channel"] == "pendulums"]
        assert ["since_ns" in event for event in silences] == [True, False] * (len(silences) // 2), "begin, then end"
        counted = losses_of(log).by_device["encoder"]["pendulums_silent_ms"]
        assert counted >= silences[-1]["pendulums_silent_ms"] > 100
        assert next(event["time_ns"] for event in log.events if event["kind"] == "stop") >= trip["time_ns"]
        speeds = log["motor"]["speed_rpm"]
        assert 0.0 < speeds[0] < speeds.max()
        assert abs(speeds[-1]) < 2.0
        before_s = (trip["time_ns"] - log["laser/x"].time_ns[0]) * 1e-9
        assert 2.5 < before_s < 3.5


def test_a_trip_before_the_log_that_cannot_be_recorded_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim, session = opened("virtual")
    messages: list[str] = []

    def full(*given: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Session, "start_recording", full)
    _dies_in_the_spin_up(sim, session, tmp_path, messages)
    assert any("the last 3 s cannot be recorded" in text and "No space left" in text for text in messages)
    assert abs(sim.far.motion.speed_rad_s) < 0.2


def test_a_test_that_ends_at_rest_before_its_log_records_none(tmp_path: Path) -> None:
    sim, session = opened("virtual")
    tests = guided(session, sim, tmp_path)
    with session:
        sim.ask("unplug", device="drive")
        with pytest.raises(AcquisitionError, match="the rotor is not turned: motor: silent"):
            tests.point("B", 500.0 * np.pi / 30)
    assert list(tmp_path.glob("*.mcap")) == []


@pytest.mark.parametrize("test", ["spin-down", "ring-down-x"])
def test_actions_of_the_operator_during_the_request_count(test: str, tmp_path: Path) -> None:
    """The request to the operator returns late: the column rings and the pendulums swing meanwhile."""
    sim, session = opened("virtual")

    class Prompt(SimulatedOperator):
        def flick(self) -> None:
            super().flick()
            sim.clock.wait(4.0)

        def pluck(self, axis: str, mm: float | None = None) -> None:
            super().pluck(axis, mm)
            sim.clock.wait(8.0)

    with session:
        done = Procedures(session, Prompt(sim), tmp_path, quiet).run(test)
    assert done.missed == ""
