"""The recorder on good, slow and full disks: accepted items are in the file, and faults are reported in time."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import threading
from collections import namedtuple

import numpy as np
import pytest

from daq.acquisition import recorder as recorder_module
from daq.acquisition.effects import Keep, Note, WriteHealth
from daq.acquisition.recorder import Recorder
from daq.channels import LASER_X
from daq.errors import LogError, RecordingError
from daq.items import RX, Batch, DeviceEvent
from daq.log import open_log
from daq.log.file import LogFile
from daq.transports import HostClock

START = 1_700_000_000_000_000_000


def batch(first, n):
    k = np.arange(first, first + n)
    columns = {"displacement_m": 1e-6 * k, "code": k, "counter": k % 2**18, "device_ticks": 25 * k, "flags": 0 * k}
    return Batch(LASER_X, START + 250_000 * k, k.astype(np.uint32), columns)


def begin(path):
    return Recorder(path, HostClock(), {"test": "small"}, {"rig.json": b"{}"}, ("laser_x",))


def turned(turn, per_turn, host_ns):
    return Keep("laser_x", RX, bytes([turn % 256]) * 50, (batch(per_turn * turn, per_turn),), host_ns)


def feed(recorder, turns, per_turn=40):
    """Run some turns of a reader. Return the number accepted before the recorder required the end of the run."""
    for turn in range(turns):
        host_ns = START + 10_000_000 * (turn + 1)
        if not recorder.add(turned(turn, per_turn, host_ns)):
            return turn
    return turns


def check_content(log, turns, per_turn=40):
    x = log["laser/x"]
    assert np.array_equal(x.counter, np.arange(turns * per_turn) % 2**18)
    assert np.array_equal(x.log_time_ns, np.repeat(START + 10_000_000 * np.arange(1, turns + 1), per_turn))
    assert [chunk.data[0] for chunk in log.raw("laser_x")] == [turn % 256 for turn in range(turns)]


def test_all_that_was_taken_is_in_the_file_in_order(tmp_path):
    recorder = begin(tmp_path / "run.mcap")
    feed(recorder, 300)
    recorder.add(Note(DeviceEvent("gap", "laser_x", "3 samples lost", {"samples": 3}), START))
    recorder.add(WriteHealth({"kind": "health", "losses": {"laser_x": {"samples": 3}}}, START))
    path = recorder.close({"losses": {"laser_x": {"samples": 3}}})
    with open_log(path) as log:
        assert log.complete
        check_content(log, 300)
        assert [event["kind"] for event in log.events] == ["gap"]
        assert log.health[0]["losses"] == {"laser_x": {"samples": 3}}
        assert log.metadata["summary"]["losses"] == '{"laser_x": {"samples": 3}}'
    assert not recorder.part.exists()


class Blocked:
    """A disk that blocks until `released` is set."""

    def __init__(self, monkeypatch):
        self.released = threading.Event()
        self.reached = threading.Event()
        flush = LogFile.flush
        first = True

        def wait(log):
            nonlocal first
            if not first:  # the file's own beginning
                self.reached.set()
                self.released.wait()
            first = False
            flush(log)

        monkeypatch.setattr(LogFile, "flush", wait)


def test_a_slow_disk_is_seen_long_before_the_run_has_to_end_and_nothing_taken_is_lost(tmp_path, monkeypatch):
    disk = Blocked(monkeypatch)
    monkeypatch.setattr(recorder_module, "BACKLOG_BYTES", 400_000)
    recorder = begin(tmp_path / "run.mcap")
    assert not recorder.state().slow
    feed(recorder, 1)
    assert disk.reached.wait(10)
    slow_at = taken = None
    for turn in range(1, 1000):
        host_ns = START + 10_000_000 * (turn + 1)
        if not recorder.add(turned(turn, 40, host_ns)):
            taken = turn
            break
        if slow_at is None and recorder.state().slow:
            slow_at = turn
    assert slow_at is not None
    assert taken is not None
    assert slow_at < taken / 10
    assert "too slow" in str(recorder.trouble)
    disk.released.set()
    path = recorder.close({"losses": {}})  # the file itself is sound and gets its name
    with open_log(path) as log:
        assert log.complete
        check_content(log, taken)


def test_the_age_of_what_the_disk_does_not_have_is_counted(tmp_path, monkeypatch):
    released, reached = threading.Event(), threading.Event()

    def wait(log):
        reached.set()
        released.wait()

    monkeypatch.setattr(LogFile, "sync", wait)
    monkeypatch.setattr(recorder_module, "_SLOW_SYNC_S", 0.0)
    recorder = begin(tmp_path / "run.mcap")
    feed(recorder, 1)
    assert reached.wait(10)
    state = recorder.state()
    assert state.slow
    assert state.unsynced_s > 0
    released.set()
    path = recorder.close({})
    with open_log(path) as log:
        assert '"slow_s": 0.0}' not in log.metadata["summary"]["disk"]


Usage = namedtuple("Usage", "total used free")


def test_a_disk_that_fills_ends_the_run_while_the_file_can_still_be_finished(tmp_path, monkeypatch):
    free = 100_000_000
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9 - free, free))
    recorder = begin(tmp_path / "run.mcap")
    feed(recorder, 50)
    recorder.look()
    assert recorder.trouble is None
    free = 1_000_000
    recorder.look()
    assert isinstance(recorder.trouble, RecordingError)
    assert "disk is full" in str(recorder.trouble)
    feed(recorder, 50)  # comes too late: the run has ended
    with open_log(recorder.close({})) as log:
        assert log.complete
        check_content(log, 50)


def test_a_log_is_not_begun_on_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 1000))
    with pytest.raises(RecordingError, match="room"):
        begin(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fails_leaves_what_was_flushed(tmp_path, monkeypatch):
    recorder = begin(tmp_path / "run.mcap")
    written = threading.Event()
    flush = LogFile.flush

    def noting(log):
        flush(log)
        written.set()

    monkeypatch.setattr(LogFile, "flush", noting)
    feed(recorder, 20)
    assert written.wait(10)

    def failing(log, *_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(LogFile, "batch", failing)
    for _ in range(2000):
        feed(recorder, 1)
        if recorder.trouble is not None:
            break
        written.wait(0.01)
    with pytest.raises(RecordingError, match="No space left") as caught:
        recorder.close({})
    assert "rig recover" in str(caught.value)
    assert not recorder.path.exists()
    with open_log(recorder.part) as log:
        assert not log.complete
        assert 0 < len(log["laser/x"]) <= 20 * 40


def test_names_are_never_written_over(tmp_path):
    path = begin(tmp_path / "run.mcap").close({})
    before = path.read_bytes()
    with pytest.raises(LogError, match="never overwritten"):
        begin(path)
    with pytest.raises(LogError, match=r"ends in \.mcap"):
        begin(tmp_path / "run.log")
    (tmp_path / "cut.mcap.part").write_bytes(b"rest")
    with pytest.raises(LogError, match="rig recover"):
        begin(tmp_path / "cut.mcap")
    assert path.read_bytes() == before
    assert (tmp_path / "cut.mcap.part").read_bytes() == b"rest"


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() != 0, reason="mounting needs root")
def test_a_small_disk_that_really_fills(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    mount = subprocess.run(command, capture_output=True, check=False)
    if mount.returncode != 0:
        pytest.skip(f"no tmpfs here: {mount.stderr.decode().strip()}")
    try:
        recorder = begin(disk / "run.mcap")
        (disk / "other").write_bytes(bytes(3_000_000))  # someone else takes the room
        dice = np.random.default_rng(1)
        taken = 0
        while recorder.trouble is None and taken < 100_000:
            recorder.add(Keep("laser_x", RX, dice.bytes(5000), (), START + taken))
            taken += 1
            recorder.look()
        assert "disk is full" in str(recorder.trouble)
        path = recorder.close({})
        with open_log(path) as log:
            assert log.complete
            assert log.count("raw/laser_x") == taken
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_recording_never_takes_a_name_that_was_taken_meanwhile(tmp_path):
    recorder = begin(tmp_path / "run.mcap")
    feed(recorder, 3)
    (tmp_path / "run.mcap").write_bytes(b"someone else's")
    with pytest.raises(RecordingError, match="exists already"):
        recorder.close({})
    assert (tmp_path / "run.mcap").read_bytes() == b"someone else's"
    with open_log(recorder.part) as log:
        check_content(log, 3)


def test_of_two_that_begin_at_once_the_later_sees_what_the_earlier_has_finished(tmp_path, monkeypatch):
    """The name is looked at again once the .part is ours: in between the other may have come to its end."""
    path = tmp_path / "run.mcap"

    opened = io.FileIO

    def other_ends(part, mode):
        path.write_bytes(b"finished")
        return opened(part, mode)

    monkeypatch.setattr("daq.log.file.io.FileIO", other_ends)
    with pytest.raises(LogError, match="never overwritten"):
        begin(path)
    assert path.read_bytes() == b"finished"
    assert not path.with_name("run.mcap.part").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be moved there")
def test_a_file_that_is_moved_away_ends_the_run_with_the_right_words(tmp_path):
    recorder = begin(tmp_path / "run.mcap")
    feed(recorder, 3)
    recorder.look()
    assert recorder.trouble is None
    recorder.part.rename(tmp_path / "moved")
    recorder.look()
    assert "moved or deleted" in str(recorder.trouble)
    assert "room" not in str(recorder.trouble)
    with pytest.raises(RecordingError, match="moved or deleted"):
        recorder.close({})


@pytest.mark.skipif(sys.platform == "win32", reason="an open file's folder cannot be moved there")
def test_a_folder_that_is_gone_ends_the_run(tmp_path):
    recorder = begin(tmp_path / "logs" / "run.mcap")
    feed(recorder, 3)
    (tmp_path / "logs").rename(tmp_path / "elsewhere")
    recorder.look()
    assert recorder.trouble is not None
    with pytest.raises(RecordingError):
        recorder.close({})
