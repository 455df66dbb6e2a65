"""Replay: bit for bit, at its pace, with corrected calibration; parts that cannot be compared are reported."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.channels import TACHO
from daq.errors import LogError
from daq.items import Batch, DeviceEvent
from daq.log import open_log
from daq.log.file import LogFile
from daq.log.losses import losses_of
from daq.replay import check, compare, paced, stream
from daq.replay.calibration import Calibration
from daq.replay.decoded_again import decode_again
from daq.replay.pace import Pace
from daq.signals.run import load_run
from rig_configs import load_rig
from rig_configs.errors import RigFileError
from tests.daq.playback.fake_ports import FakeClock
from tests.daq.replayed_log import START_NS, STEP_NS, Falsify, write_log
from tests.daq.small_log import write_small_log


@pytest.fixture
def small_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slices and windows so small that every log has many."""
    monkeypatch.setattr(compare, "_SLICE", 64)
    monkeypatch.setattr(stream, "_ROWS", 100)


# --- compared ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize("what", [{}, {"lost": frozenset({7, 8, 30})}, {"restarts_at": 31}, {"steps": 1}])
def test_what_was_recorded_is_decoded_again_bit_for_bit(tmp_path: Path, what: dict[str, Any]) -> None:
    found = check(write_log(tmp_path / "a.mcap", **what))
    assert found.identical
    assert found.until_ns is None
    assert {
        row.topic: (row.live - row.compared, row.again - row.compared) for row in found if row.topic != "events"
    } == dict.fromkeys(("laser/x", "laser/y", "pendulums", "tacho", "motor"), (0, 0))
    steps = what.get("steps", 60)
    assert next(iter(found)).live == 40 * steps
    assert all(row.live > 0 for row in found)


@pytest.mark.usefixtures("small_slices")
def test_samples_come_in_the_order_of_the_file_where_their_times_step_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock mapped again: sample times step back by 7 ms every 50, sometimes across a window's end at 20 ms."""
    monkeypatch.setattr(stream, "_ROWS", 20)
    number = np.arange(400)
    time_ns = START_NS + 1_000_000 * (number - 7 * (number // 50))
    with LogFile(tmp_path / "a.mcap", {}, {}, (), START_NS) as log:
        for i in range(0, 400, 2):
            part = slice(i, i + 2)
            columns = {"revolutions": number[part], "node_time_us": number[part]}
            log.batch(Batch(TACHO, time_ns[part], number[part].astype(np.uint32), columns), START_NS + 1_000_000 * i)
        path = log.finish({})
    with open_log(path) as opened:
        rows = stream.StoredRows(opened, "tacho")
        parts = [rows.read_next(33)["sequence"] for _ in range(13)]
    assert np.array_equal(np.concatenate(parts), number)


def falsified(topic: str, number: int, change: Callable[[dict[str, Any], Batch], None]) -> Falsify:
    """Changes one batch of a channel; `change` receives its arrays (as a dict that also has time_ns and sequence)."""
    seen = [0]

    def falsify(_: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, Any]:
        if not isinstance(item, Batch) or item.channel.topic != topic:
            return item, host_ns
        seen[0] += 1
        if seen[0] - 1 != number:
            return item, host_ns
        arrays: dict[str, Any] = {name: np.array(values) for name, values in item.columns.items()}
        arrays |= {"time_ns": item.time_ns.copy(), "sequence": item.sequence.copy()}
        arrays["log_time_ns"] = np.full(len(item.time_ns), host_ns)
        change(arrays, item)
        log_time = arrays.pop("log_time_ns")
        return Batch(item.channel, arrays.pop("time_ns"), arrays.pop("sequence"), arrays), log_time

    return falsify


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize(
    ("topic", "field", "by"),
    [
        ("laser/x", "displacement_m", 1e-18),
        ("laser/x", "code", 1),
        ("laser/x", "counter", 1),
        ("laser/x", "device_ticks", 1),
        ("laser/y", "time_ns", 1),
        ("laser/y", "log_time_ns", 1),
        ("laser/y", "sequence", 1),
        ("pendulums", "theta3_rad", 1e-15),
        ("pendulums", "count_b", -1),
        ("pendulums", "flags", 1),
        ("tacho", "revolutions", 1),
        ("motor", "target_rpm", 1.0),
        ("motor", "statusword", 1),
    ],
)
def test_every_field_of_every_sample_is_compared(tmp_path: Path, topic: str, field: str, by: float) -> None:
    original: list[tuple[Any, int]] = []

    def change(arrays: dict[str, Any], batch: Batch) -> None:
        row = len(batch.time_ns) // 2
        arrays[field] = arrays[field].astype(np.int64) if arrays[field].dtype.kind in "iu" else arrays[field]
        original.append((arrays[field][row].item(), row))
        arrays[field][row] += by

    path = write_log(tmp_path / "a.mcap", falsify=falsified(topic, 20, change))
    rows = {row.topic: row for row in check(path)}
    assert [row.topic for row in rows.values() if row.difference] == [topic]
    assert rows[topic].differing == 1
    first = rows[topic].first
    assert (first.field, first.decoded) == (field, original[0][0])
    assert first.stored == original[0][0] + by
    with open_log(path) as log:
        samples = log[topic]
        stored = {"time_ns": samples.time_ns, "log_time_ns": samples.log_time_ns, "sequence": samples.sequence}
        assert (stored | samples.columns)[field][first.index] == first.stored
        assert samples.time_ns[first.index] == first.time_ns


def test_nan_is_the_same_nan_and_minus_zero_is_not_zero(tmp_path: Path) -> None:
    def change(arrays: dict[str, Any], _: Batch) -> None:
        arrays["speed_rpm"][:] = math.nan

    rows = check(write_log(tmp_path / "a.mcap", falsify=falsified("motor", 3, change)))
    row = next(row for row in rows if row.topic == "motor")
    assert row.differing == 1
    assert row.fields["speed_rpm"].largest == 0.0  # no measurable distance, but different bits
    before = np.array([0.0, math.nan, 1.0])
    assert compare._differing(before, np.array([-0.0, math.nan, 1.0])).tolist() == [True, False, False]


def test_a_missing_and_an_invented_batch_are_differences_in_a_whole_log(tmp_path: Path) -> None:
    seen = [0]

    def leave_out(_: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int] | None:
        if isinstance(item, Batch) and item.channel.topic == "tacho":
            seen[0] += 1
        return None if seen[0] == 60 and isinstance(item, Batch) and item.channel.topic == "tacho" else (item, host_ns)

    row = next(r for r in check(write_log(tmp_path / "a.mcap", falsify=leave_out)) if r.topic == "tacho")
    assert (row.live, row.again, row.differing) == (59, 60, 1)
    assert row.difference == "59 samples live, 60 decoded again"
    assert (row.first.index, row.first.stored, row.first.decoded) == (59, None, 119)

    def invent(arrays: dict[str, Any], batch: Batch) -> None:
        arrays |= {name: np.repeat(values, 2) for name, values in arrays.items()}

    row = next(
        r for r in check(write_log(tmp_path / "b.mcap", falsify=falsified("tacho", 59, invent))) if r.topic == "tacho"
    )
    assert (row.live, row.again, row.differing) == (61, 60, 1)
    assert (row.first.index, row.first.decoded) == (60, None)


@pytest.mark.parametrize("change", ["text", "fact", "left out", "late"])
def test_events_are_compared_with_their_facts(tmp_path: Path, change: str) -> None:
    def falsify(_: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int] | None:
        if not isinstance(item, DeviceEvent) or item.kind != "gap":
            return item, host_ns
        if change == "left out":
            return None
        facts = dict(item.facts) | ({"samples": 41} if change == "fact" else {})
        if change == "late":
            facts["time_ns"] = host_ns + 1
        return DeviceEvent(item.kind, item.device, "x" if change == "text" else item.text, facts), host_ns

    path = write_log(tmp_path / "a.mcap", falsify=falsify, lost=frozenset({9}))
    rows = {row.topic: row for row in check(path)}
    assert [row.topic for row in rows.values() if row.difference] == ["events"]
    first = rows["events"].first
    assert rows["events"].differing == 1
    expected = {"text": "text", "fact": "samples", "left out": "kind", "late": "time_ns"}
    assert first.field == expected[change]


def test_the_hosts_own_events_are_not_asked_of_the_raw_bytes(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap")
    with open_log(path) as log:
        assert [event["device"] for event in log.events if event["kind"] == "disk"] == ["host"]
    assert check(path).identical


def test_a_cut_log_is_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    part = write_log(tmp_path / "a.mcap", finish=False, unwritten_from=200)
    found = check(part)
    assert found.identical
    assert found.until_ns is None
    assert sum(row.extra for row in found) > 100
    assert any("cut" in note for note in found.notes)
    with open_log(part) as log:
        for row in list(found)[:-1]:
            assert row.compared == log.count(row.topic)
            assert row.again == row.compared + row.extra


def test_what_a_whole_log_lacks_is_no_cut(tmp_path: Path) -> None:
    found = check(write_log(tmp_path / "a.mcap", unwritten_from=200))
    assert not found.identical


def damage_chunk_at(path: Path, share: float) -> None:
    """Flip a byte in the middle of the chunk at a given share of the file."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    at = path.stat().st_size * share
    chunk = max((c for c in summary.chunk_indexes if c.chunk_start_offset < at), key=lambda c: c.chunk_start_offset)
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x10
    path.write_bytes(data)


@pytest.mark.usefixtures("small_slices")
def test_a_damaged_log_is_compared_up_to_the_first_missing_raw_bytes(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", steps=100)
    whole = {row.topic: row.compared for row in check(path)}
    damage_chunk_at(path, 0.5)
    found = check(path)
    assert found.identical
    assert found.until_ns is not None
    until_s = (found.until_ns - START_NS) * 1e-9
    assert 0.2 < until_s < 0.8
    compared = {row.topic: row.compared for row in found}
    for topic in ("laser/x", "laser/y", "pendulums"):
        assert compared[topic] / whole[topic] == pytest.approx(until_s, abs=0.03)
    assert any("not beyond" in note for note in found.notes)
    assert not any(row.extra for row in found)


def test_what_differs_before_the_damage_is_still_found(tmp_path: Path) -> None:
    def change(arrays: dict[str, Any], _: Batch) -> None:
        arrays["displacement_m"][0] += 1e-9

    path = write_log(tmp_path / "a.mcap", steps=100, falsify=falsified("laser/x", 5, change))
    damage_chunk_at(path, 0.5)
    assert [row.topic for row in check(path) if row.difference] == ["laser/x"]


def test_a_log_without_raw_bytes_is_refused_as_not_decodable(tmp_path: Path) -> None:
    with LogFile(tmp_path / "a.mcap", {"test": "imported"}, {}, (), START_NS) as log:
        path = log.finish({})
    with pytest.raises(LogError, match="no raw bytes"):
        check(path)


def test_a_log_without_its_rig_file_is_refused(tmp_path: Path) -> None:
    with LogFile(tmp_path / "a.mcap", {}, {"identities.json": b"{}"}, ("laser_x",), START_NS) as log:
        log.raw("laser_x", 0, b"abc", START_NS)
        path = log.finish({})
    with pytest.raises(LogError, match=r"rig\.json"):
        check(path)


# --- at a pace ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.5, 1.0, 8.0])
def test_everything_comes_at_its_time_for_any_sum_of_waits(tmp_path: Path, speed: float) -> None:
    clock = FakeClock()
    clock_sleep = clock.wait
    clock.wait = lambda seconds: clock_sleep(seconds + 3e-4)  # every sleep is too long
    with open_log(write_log(tmp_path / "a.mcap")) as log:
        started, reached = clock.ns, START_NS
        for _, chunk, _ in paced(log, speed, clock):
            reached = max(reached, chunk.host_ns)  # the devices' reads are not in strict order of time
            due = started + (reached - START_NS) / speed
            assert due - 2 <= clock.ns <= due + 3.1e5
    assert reached > START_NS + 59 * STEP_NS


def test_after_a_stall_it_catches_up_and_reports_how_late_it_was(tmp_path: Path) -> None:
    clock = FakeClock()
    with open_log(write_log(tmp_path / "a.mcap")) as log:
        replayed = paced(log, 2.0, clock)
        for number, _ in enumerate(replayed):
            if number == 100:
                clock.ns += 100_000_000
                clock.slept.clear()
            if number == 101:
                assert replayed.pace.late_s == pytest.approx(0.1, abs=0.01)
                assert clock.slept == []
    assert replayed.pace.late_s < 1e-3
    assert 0.09 < replayed.pace.most_late_s < 0.1001
    assert clock.ns == pytest.approx(5_000_000_000 + 60 * STEP_NS / 2, abs=2e6)


def test_max_waits_for_nothing(tmp_path: Path) -> None:
    clock = FakeClock()
    with open_log(write_log(tmp_path / "a.mcap")) as log:
        items = [item for _, _, found in paced(log, math.inf, clock) for item in found]
    assert clock.slept == []
    assert sum(len(item.time_ns) for item in items if isinstance(item, Batch)) == 60 * (40 + 40 + 10 + 1 + 1)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_an_invalid_speed_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        Pace(speed, FakeClock())


# --- decoding into a new log -------------------------------------------------------------------------------------


def calibration(tmp_path: Path, text: str) -> Calibration:
    path = tmp_path / "calibration.toml"
    path.write_text(text, encoding="utf-8")
    return Calibration.load(path)


def test_a_corrected_range_replaces_the_range_of_the_sensor(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap")
    better = calibration(tmp_path, "[devices.laser_x]\nrange_m = 0.02505\n")
    made = decode_again(path, tmp_path / "b.mcap", better)
    with open_log(path) as old, open_log(made.path) as new:
        assert np.allclose(new["laser/x"].displacement_m, old["laser/x"].displacement_m * 0.02505 / 0.025, rtol=1e-12)
        assert np.array_equal(new["laser/y"].displacement_m, old["laser/y"].displacement_m)
        identity = json.loads(new.attachments["identities.json"])["laser_x"]
        assert (identity["range_m"], identity["told_range_m"]) == (0.02505, 0.025)
        assert json.loads(new.attachments["rig.json"])["devices"]["laser_x"]["range_m"] == 0.02505
        moved = np.abs(new["laser/x"].displacement_m - old["laser/x"].displacement_m)
    row = next(row for row in made.moved if row.topic == "laser/x")
    assert set(row.fields) == {"displacement_m"}
    assert row.fields["displacement_m"].largest == pytest.approx(moved.max(), rel=1e-12)
    assert row.fields["displacement_m"].rms == pytest.approx(float(np.sqrt(np.mean(moved**2))), rel=1e-12)
    assert [row.topic for row in made.moved if row.fields] == ["laser/x"]


@pytest.mark.usefixtures("small_slices")
def test_every_calibration_is_applied_as_stated_and_the_new_log_replays_exactly(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", lost=frozenset({9}))
    text = (
        "[devices.laser_y]\nlever_ratio = 0.9\ngain_std = 0.002\nclock_tolerance_ppm = 10\n"
        "[devices.encoder]\ncounts_per_revolution = 8192\nindex_angle_deg = 30.0\nzero_std_deg = 0.1\n"
    )
    made = decode_again(path, tmp_path / "b.mcap", calibration(tmp_path, text))
    assert check(made.path).identical
    with open_log(path) as old, open_log(made.path) as new:
        assert np.allclose(new["laser/y"].displacement_m * 0.9, old["laser/y"].displacement_m, rtol=1e-12)
        assert np.allclose(new["pendulums"].theta3_rad * 2, old["pendulums"].theta3_rad, rtol=1e-12)
        assert new.complete
        assert new.attachments["calibration.toml"].decode() == text
        assert new.attachments["rig.origin.json"] == old.attachments["rig.json"]
        devices = json.loads(new.attachments["rig.json"])["devices"]
        assert devices["laser_y"]["gain_std"] == 0.002
        assert devices["encoder"]["index_angle_deg"] == 30.0
    old_run, new_run = load_run(path), load_run(made.path)
    assert np.allclose(new_run.mark_phase_rad - old_run.mark_phase_rad, math.radians(30.0))
    assert np.allclose(new_run.y_m * 0.9, old_run.y_m, rtol=1e-12)
    assert new_run.test == "point-A"


def test_without_a_calibration_everything_is_as_it_was_and_names_its_origin(tmp_path: Path) -> None:
    import hashlib

    path = write_log(tmp_path / "a.mcap", lost=frozenset({9}))
    made = decode_again(path, tmp_path / "b.mcap")
    assert not any(row.fields for row in made.moved)
    with open_log(path) as old, open_log(made.path) as new:
        for device in old.devices:
            assert new.raw(device) == old.raw(device)
        assert new.health == old.health
        assert [e for e in new.events if e["device"] == "host"] == [e for e in old.events if e["device"] == "host"]
        assert losses_of(new).by_device == losses_of(old).by_device
        assert losses_of(new).by_device["laser_y"]["samples"] == 40
        run = new.metadata["run"]
        assert run["origin"] == "a.mcap"
        assert run["origin_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert (run["test"], run["note"], run["origin_software"]) == ("point-A", "springs changed", "0.0.1")
        summary = new.metadata["summary"]
        assert json.loads(summary["ended"]) == "duration"
        assert json.loads(summary["verdict"]) == {"settled": True}
        assert json.loads(summary["losses_of_origin"]) == json.loads(old.metadata["summary"]["losses"])
    again = decode_again(made.path, tmp_path / "c.mcap")
    with open_log(again.path) as third:
        assert third.metadata["run"]["origin"] == "b.mcap"
        assert third.metadata["run"]["origin.origin"] == "a.mcap"


def test_a_cut_and_a_damaged_log_become_whole_ones_that_list_what_was_missing(tmp_path: Path) -> None:
    part = write_log(tmp_path / "a.mcap", finish=False, unwritten_from=200)
    made = decode_again(part, tmp_path / "b.mcap")
    assert made.missing
    found = check(made.path)
    assert found.identical
    assert next(iter(found)).live == 2400  # including the samples that were never written
    damaged = write_log(tmp_path / "c.mcap", steps=100)
    damage_chunk_at(damaged, 0.5)
    made = decode_again(damaged, tmp_path / "d.mcap")
    assert check(made.path).identical
    with open_log(made.path) as log:
        assert json.loads(log.metadata["summary"]["missing_of_origin"]) == list(made.missing)
        assert log.complete


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[devices.laser_x]\nrange = 0.02", r"devices\.laser_x\.range: .*did you mean devices\.laser_x\.range_m"),
        ("[devices.laser_x]\nport = 'x'", r"devices\.laser_x\.port: .*range_m, lever_ratio"),
        ("[devices.laser_x]\nrate_Hz = 1000", r"devices\.laser_x\.rate_Hz"),
        ("[devices.laserx]\nrange_m = 0.02", r"did you mean devices\.laser_x"),
        ("[devices.drive]\nnode_id = 3", r"devices\.drive"),
        ("[device.laser_x]\nrange_m = 0.02", r"did you mean devices"),
        ("[devices]\nlaser_x = 3", "expected a table"),
        ("devices = 3", "expected a table"),
        ("", "found none"),
        ("[devices.laser_x]", "found none"),
        ("not toml", "TOML"),
    ],
)
def test_only_calibration_is_taken(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(RigFileError, match=words):
        calibration(tmp_path, text).correct(load_rig("virtual"))


def test_a_calibration_that_cannot_be_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "a.mcap")
    with pytest.raises(RigFileError, match=r"calibration\.toml: devices\.laser_x\.lever_ratio: .* got -1"):
        decode_again(path, tmp_path / "b.mcap", calibration(tmp_path, "[devices.laser_x]\nlever_ratio = -1\n"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "calibration.toml"]


def test_nothing_is_written_over_and_no_half_log_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_small_log(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="exists already"):
        decode_again(path, path)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(LogFile, "finish", interrupted)
    with pytest.raises(KeyboardInterrupt):
        decode_again(path, tmp_path / "b.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
