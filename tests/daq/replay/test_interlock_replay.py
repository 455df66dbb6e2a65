"""A log evaluated by the interlocks again: the same trips as in the session, none in a faultless run, other limits, and
incomplete logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.acquisition.interlock_table import CHANNELS, LOOK_S
from daq.channels import LASER_X, MOTOR, TACHO
from daq.errors import LogError
from daq.items import Batch, DeviceEvent
from daq.log import open_log, recover, snapshot
from daq.log.file import LogFile
from daq.log.snapshot import rig_of
from daq.replay.arrivals import Arrivals
from daq.replay.checking import Holes
from daq.replay.commanded_speeds import LoggedSpeeds, report_hand_speeds, standing_speed
from daq.replay.interlocked import InterlockReplay, replay_interlocks
from daq.replay.stream import pipelines_of
from rig_configs import RigFileError, load_rig
from rig_configs.drivers import installed
from tests.daq.acquisition.test_interlock_table import SCENARIOS
from tests.daq.far_ends import START_NS
from tests.daq.recorded_bench import RecordedBench
from tests.daq.replayed_log import write_log


def judged(path: Path, *settings: str, all_trips: bool = False) -> InterlockReplay:
    with open_log(path) as log:
        return replay_interlocks(log, settings, all_trips=all_trips)


def sound_run(path: Path, **how) -> Path:
    with RecordedBench(path, **how) as bench:
        bench.beat()
        bench.turn(600)
        bench.pass_time(1.0)
        bench.quick_stop()
        bench.pass_time(2.0)
        assert bench.stops == []
        return bench.finish()


def test_a_sound_run_trips_nothing(tmp_path: Path) -> None:
    found = judged(sound_run(tmp_path / "a.mcap"), all_trips=True)
    assert (found.trips, found.notes, found.stops) == ((), (), ())
    assert (found.until_ns - found.start_ns) * 1e-9 == pytest.approx(6.0, abs=0.1)


BY_BYTES = [row for row in CHANNELS if row.name != "fault"]
"""Rows that this rig's bytes make trip; its drive reports no fault of its own kind (see the test of stored events)."""


@pytest.mark.parametrize("row", BY_BYTES, ids=lambda row: row.name)
def test_what_tripped_live_trips_in_a_replay(row, tmp_path: Path) -> None:
    happens_so, settings = SCENARIOS[row.name]
    with RecordedBench(tmp_path / "a.mcap", *settings) as bench:
        bench.beat()
        bench.turn(600)
        happens_so(bench)
        bench.pass_time(4.0)
        path = bench.finish()
        first_s, first = bench.stops[0]
        live = {stop.interlock for _, stop in bench.stops}
    found = judged(path, all_trips=True)
    assert {trip.interlock for trip in found.trips} == live
    trip = found.trips[0]
    assert (trip.time_ns - START_NS) * 1e-9 == pytest.approx(first_s, abs=LOOK_S + 0.01)
    assert trip.text.partition(":")[0] == first.text.partition(":")[0]
    assert trip.cause == first.cause
    alone = judged(path)
    assert alone.trips[0].time_ns == trip.time_ns
    assert all(each.time_ns <= trip.time_ns + 300_000_000 for each in alone.trips)
    assert alone.until_ns < found.until_ns


def test_other_limits_answer_what_if(tmp_path: Path) -> None:
    path = sound_run(tmp_path / "a.mcap")
    (amplitude, *_) = judged(path, "limits.amplitude_m=0.0001").trips
    assert amplitude.interlock == "amplitude"
    assert "limits.amplitude_m is 0.1 mm" in amplitude.text
    assert amplitude.told_rpm == 600
    assert amplitude.newest["motor"]["speed_rpm"] == pytest.approx(amplitude.speed_rpm, abs=60)
    overspeed = judged(path, "limits.speed_rpm=400").trips[0]
    assert (overspeed.interlock, overspeed.cause) == ("overspeed", "procedure")
    with pytest.raises(RigFileError, match=r"did you mean limits\.amplitude_m"):
        judged(path, "limits.amplitude=0.0001")
    with pytest.raises(RigFileError, match="cannot be measured"):
        judged(path, "limits.amplitude_m=1.0")


def test_a_trip_ends_the_run_unless_all_are_asked_for(tmp_path: Path) -> None:
    path = sound_run(tmp_path / "a.mcap")
    first = judged(path, "limits.amplitude_m=0.0001")
    every = judged(path, "limits.amplitude_m=0.0001", all_trips=True)
    assert first.until_ns < every.until_ns
    assert first.until_ns <= first.trips[0].time_ns + 400_000_000
    assert len(every.trips) > len(first.trips)
    assert [trip.time_ns for trip in every.trips] == sorted(trip.time_ns for trip in every.trips)
    assert every.trips[0].found > first.trips[0].found


def test_several_at_once_are_all_named(tmp_path: Path) -> None:
    with RecordedBench(tmp_path / "a.mcap") as bench:
        bench.turn(600)
        bench.fails("laser_x", "code", 262076)
        bench.fails("encoder", "flags", 3)
        bench.pass_time(1.0)
        path = bench.finish()
    found = judged(path)
    assert {trip.interlock for trip in found.trips} == {"blind sensor", "encoder fault"}
    assert sum("fault of encoder" in trip.text for trip in found.trips) == 2


# --- commands ------------------------------------------------------------------------------------------------------


def test_one_who_only_listened_takes_the_drive_s_word_for_its_commands(tmp_path: Path) -> None:
    found = judged(sound_run(tmp_path / "a.mcap", listened=True), all_trips=True)
    assert found.trips == ()
    assert "a runaway was not judged" in found.notes[-1]


def motor(rpm: list[float], target: list[float] | None) -> Batch:
    n = len(rpm)
    columns = {"speed_rpm": np.array(rpm, float)}
    if target is not None:
        columns["target_rpm"] = np.array(target, float)
    return Batch(MOTOR, np.zeros(n, np.int64), np.zeros(n, np.uint32), columns)


def test_commands_are_reported_once_and_in_their_order() -> None:
    speeds: list[float] = []
    commands = LoggedSpeeds(speeds.append, whole=True)
    commands.sent()
    commands.follow(motor([0, 0], [0, 0]))
    commands.follow(motor([0, 5, 9, 12], [0, 300, 300, 0]))
    commands.follow(motor([12, 12], [0, np.nan]))
    assert (speeds, commands.rpm) == ([0, 300, 0], 0)


def test_a_command_that_the_log_does_not_hold_is_the_drive_s_own_word_until_the_next_one() -> None:
    speeds: list[float] = []
    commands = LoggedSpeeds(speeds.append, whole=True)
    commands.sent()
    commands.follow(motor([590, 600], [0, 0]))
    assert (speeds, commands.rpm) == ([590, 600, 600], None)
    commands.follow(motor([600], [0]))
    assert commands.rpm is None
    commands.follow(motor([600, 601], [0, 700]))
    assert (speeds[-1], commands.rpm) == (700, 700)


def test_behind_a_hole_a_rotor_at_rest_has_no_command_that_is_known() -> None:
    speeds: list[float] = []
    commands = LoggedSpeeds(speeds.append, whole=False)
    commands.sent()
    commands.follow(motor([0], [600]))
    assert (commands.rpm, speeds) == (None, [0, 0, 0])
    no_field = LoggedSpeeds(speeds.append, whole=True)
    no_field.sent()
    no_field.follow(motor([0], None))
    assert no_field.rpm is None


def test_a_test_that_begins_at_a_speed_names_the_command_that_stands() -> None:
    assert standing_speed({"test": "point-A", "speed_rpm": "143.25"}) == 143.25
    assert standing_speed({"test": "run-down", "top_rpm": "600"}) == 600
    for facts in (
        {"test": "run-up", "top_rpm": "600"},
        {"test": "point-A", "speed_rpm": "nan"},
        {"test": "point-A"},
        {},
    ):
        assert standing_speed(facts) is None
    speeds: list[float] = []
    commands = LoggedSpeeds(speeds.append, whole=True, standing=600.0)
    commands.follow(motor([600], [0]))
    commands.follow(motor([600], [300]))
    assert speeds == [600, 300]


@pytest.mark.parametrize(
    ("facts", "speeds"),
    [
        ({"test": "run-up", "top_rpm": "500"}, [500]),
        ({"test": "point-B"}, [1200]),
        ({"test": "run-down", "top_rpm": "500"}, [500, 0]),
        ({"test": "spin-down"}, []),
        ({"test": "record"}, []),
        ({}, []),
    ],
)
def test_the_commands_to_a_rotor_by_hand_follow_from_its_test(facts: dict[str, str], speeds: list[float]) -> None:
    heard: list[float] = []
    report_hand_speeds(heard.append, facts, 1200.0)
    assert heard == speeds


# --- other facts of a session ---------------------------------------------------------------------------------------


def test_at_rest_only_what_the_test_needs_trips(tmp_path: Path) -> None:
    for test, tripped in (("ring-down-x", []), ("spin-down", ["silent angles"])):
        with RecordedBench(tmp_path / f"{test}.mcap", test=test) as bench:
            bench.fails("encoder", "dead")
            bench.pass_time(4.0)
            path = bench.finish()
        assert [trip.interlock for trip in judged(path).trips] == tripped


def test_what_devices_do_as_their_session_releases_them_is_no_trip(tmp_path: Path) -> None:
    for ended, tripped in (("Ctrl-C", []), ("duration", ["left operation"])):
        with RecordedBench(tmp_path / f"{ended}.mcap") as bench:
            bench.beat()
            bench.pass_time(1.0)
            bench.fails("drive", "network", 0x7F)
            bench.pass_time(0.5)
            path = bench.finish(ended)
        found = judged(path)
        assert [trip.interlock for trip in found.trips] == tripped
        assert bool(found.notes) != bool(tripped)


def test_a_stop_that_the_session_made_is_found_even_in_the_last_seconds(tmp_path: Path) -> None:
    with RecordedBench(tmp_path / "a.mcap") as bench:
        bench.beat()
        bench.pass_time(1.0)
        bench.fails("drive", "network", 0x7F)
        bench.pass_time(0.2)
        bench.note(DeviceEvent("stop", "host", bench.why()))
        bench.pass_time(0.5)
        path = bench.finish(bench.why())
    found = judged(path)
    assert [trip.interlock for trip in found.trips] == ["left operation"]
    assert found.stops[0]["text"] == bench.why()


# --- incomplete logs -----------------------------------------------------------------------------------------------


def test_stored_samples_stand_in_for_bytes_that_are_not_there(tmp_path: Path) -> None:
    path = sound_run(tmp_path / "a.mcap", raw=False)
    found = judged(path, all_trips=True)
    assert found.trips == ()
    assert any("judged by stored samples" in note for note in found.notes)
    assert judged(path, "limits.amplitude_m=0.0001").trips[0].interlock == "amplitude"


def test_a_device_that_was_recorded_and_never_spoke_is_silent(tmp_path: Path) -> None:
    class WithoutOneLaser(RecordedBench):
        def _keep(self, name: str, direction: int, data: bytes) -> None:
            if name != "laser_x":
                super()._keep(name, direction, data)

    with WithoutOneLaser(tmp_path / "a.mcap") as bench:
        bench.beat()
        bench.turn(600)
        path = bench.finish()
    (trip,) = judged(path).trips
    assert (trip.interlock, trip.text[:15]) == ("silent displacement", "laser/x: silent")


def test_a_device_s_events_count_where_its_driver_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RecordedBench(tmp_path / "a.mcap") as bench:
        bench.turn(600)
        bench.note(DeviceEvent("fault", "drive", "the rotor does not follow"))
        bench.pass_time(1.0)
        path = bench.finish()
    assert judged(path).trips == ()  # its bytes contain no commands
    left = {name: point for name, point in installed().items() if name != "cia402"}
    monkeypatch.setattr(snapshot, "installed", lambda: left)
    assert [trip.interlock for trip in judged(path).trips] == ["fault"]


def test_a_cut_log_is_judged_as_far_as_it_goes(tmp_path: Path) -> None:
    with RecordedBench(tmp_path / "a.mcap") as bench:
        bench.turn(600)
        bench.log.flush()
        bench.fails("laser_x", "code", 262076)
        bench.pass_time(1.0)
        bench.log.flush()
        bench.log.close()
    part = tmp_path / "a.mcap.part"
    assert [trip.interlock for trip in judged(part).trips] == ["blind sensor"]
    whole = part.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    cut = judged(tmp_path / "cut.mcap")
    assert cut.trips == ()
    assert any("the log is cut" in note and "was not judged" in note for note in cut.notes)


def with_a_hole(path: Path, seconds: float, command_in_it: bool = False) -> Path:
    """A rotor at 300 rpm, then a damaged chunk of some seconds, then continued operation."""
    with RecordedBench(path) as bench:
        bench.beat()
        bench.turn(300)
        bench.log.flush()
        start = bench.log.part.stat().st_size
        if command_in_it:
            bench.turn(600, seconds=seconds)
        else:
            bench.pass_time(seconds)
        bench.log.flush()
        end = bench.log.part.stat().st_size
        bench.pass_time(2.0)
        assert bench.stops == []
        made = bench.finish()
    data = bytearray(made.read_bytes())
    for place in range(start + 400, end - 400, 97):
        data[place] ^= 0xFF
    made.write_bytes(data)
    return made


@pytest.mark.parametrize("command_in_it", [False, True])
def test_a_hole_is_neither_silence_nor_a_runaway(tmp_path: Path, command_in_it: bool) -> None:
    path = with_a_hole(tmp_path / "a.mcap", 6.0, command_in_it)
    found = judged(path, all_trips=True)
    assert found.trips == ()
    assert any("nothing was judged there" in note for note in found.notes)
    (tripped, *_) = judged(path, "limits.speed_rpm=250").trips
    assert (tripped.time_ns - START_NS) * 1e-9 < 2.5
    recovered = recover.recover(path, tmp_path / "whole.mcap").path
    assert recovered is not None
    assert judged(recovered, all_trips=True).trips == ()


def test_holes_are_those_between_two_known_times() -> None:
    from daq.mcap.damage import Missing

    known = Missing("x", start_ns=5, end_ns=9, messages=3)
    places = [
        replace(known, start_ns=20, end_ns=30),
        known,
        replace(known, messages=0),
        replace(known, end_ns=None),
        replace(known, topics=("health",)),
    ]
    assert Holes.of(places).between == ((5, 9), (20, 30))


def test_an_imported_log_is_judged_by_what_it_holds(tmp_path: Path) -> None:
    rig = load_rig("virtual")
    plain = replace(LASER_X, fields=LASER_X.fields[:1])
    t = START_NS + 250_000 * np.arange(8000)
    with LogFile(
        tmp_path / "a.mcap",
        {"test": "run-up"},
        {"rig.json": rig.snapshot_json()},
        (),
        START_NS,
        [plain, replace(TACHO, fields=TACHO.fields[:1])],
    ) as log:
        x = {"displacement_m": np.where(np.arange(8000) > 6000, 12e-3, 1e-3)}
        log.batch(Batch(plain, t, np.arange(8000).astype(np.uint32), x), t)
        marks = t[::400]
        tacho = replace(TACHO, fields=TACHO.fields[:1])
        log.batch(Batch(tacho, marks, np.arange(20).astype(np.uint32), {"revolutions": np.arange(20)}), marks)
        path = log.finish({})
    found = judged(path)
    assert [trip.interlock for trip in found.trips] == ["amplitude"]
    assert "laser/x: 12.0 mm" in found.trips[0].text
    left_out = [note for note in found.notes if note.startswith("not judged")]
    assert len(left_out) == 3  # laser y, pendulums, motor
    assert found.roles.speed is None


def test_a_log_of_the_project_s_small_fixture_and_one_without_a_rig(tmp_path: Path) -> None:
    assert judged(write_log(tmp_path / "a.mcap")).trips is not None
    with LogFile(tmp_path / "b.mcap", {"test": "record"}, {}, (), START_NS) as log:
        path = log.finish({})
    with pytest.raises(LogError, match=r"rig\.json"):
        judged(path)


def test_reads_that_stand_the_wrong_way_round_are_put_in_order(tmp_path: Path) -> None:
    """Threads write their reads a little late: the file's order is nearly, but not exactly, that of time."""
    path = write_log(tmp_path / "a.mcap")
    with open_log(path) as log:
        rig = rig_of(log)
        stood = [chunk.host_ns for _, chunk in log.raw_in_order()]
        arrivals = Arrivals(log, pipelines_of(log), rig.roles.device_of, 0.2)
        came = list(arrivals)
        again = {device: [a.host_ns for a in came if a.device == device] for device in log.devices}
    assert stood != sorted(stood)
    assert [arrival.host_ns for arrival in came] == sorted(stood)
    assert all(times == sorted(times) for times in again.values())
