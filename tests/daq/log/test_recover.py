"""rig recover: a new complete log from the intact parts of a cut or damaged one; no file is modified or overwritten."""

import io
import json
import os

import numpy as np
import pytest
from mcap.reader import make_reader

from benchmarks.damaged_logs import ATTACHMENTS, METADATA, chunk_spans, make_shape
from daq import channels as ch
from daq.errors import LogError, RecordingError
from daq.log import open_log, recover as module
from daq.log.file import LogFile
from daq.log.recover import recover
from rig_cli.recover import recover as command
from tests.daq.mcap.written import add_channel, marks, written
from tests.daq.small_log import write_small_log

CUT = make_shape("zstd", False, 30, 50, 1, 2**18)
WHOLE = make_shape("zstd", True, 30, 50, 1, 2**18)


@pytest.fixture
def part(tmp_path):
    path = tmp_path / "run.mcap.part"
    path.write_bytes(CUT.data[:-3])
    return path


def test_a_cut_log_becomes_whole(part):
    before = part.read_bytes()
    shares = []
    found = recover(part, progress=shares.append)
    assert found.path == part.with_name("run.mcap")
    assert part.read_bytes() == before
    assert sorted(path.name for path in part.parent.iterdir()) == ["run.mcap", "run.mcap.part"]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    with open_log(part) as old, open_log(found.path) as new:
        assert not old.complete
        assert new.verify() == []
        assert np.array_equal(old["laser/x"].code, new["laser/x"].code)
        assert np.array_equal(old["laser/x"].time_ns, new["laser/x"].time_ns)
        assert list(old.raw_in_order()) == list(new.raw_in_order())
        assert (old.events, old.attachments) == (new.events, ATTACHMENTS)
        assert new.metadata["run"] == METADATA["run"]
        assert json.loads(new.metadata["summary"]["ended"]) == "cut; recovered"
        assert new.metadata["recovered"]["origin"] == part.name
        assert new.metadata["recovered"]["missing"].split("\n") == [str(place) for place in found.missing]
        assert found.messages == sum(new.count(topic) for topic in new.topics)
        assert found.chunks == new.chunk_count - 1  # the definitions precede the copied ones
        assert found.seconds == pytest.approx(29 * 0.01)


def test_the_library_reads_it_with_every_crc(part):
    found = recover(part)
    data = found.path.read_bytes()
    messages = list(make_reader(io.BytesIO(data), validate_crcs=True).iter_messages())
    assert len(messages) == found.messages
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary.statistics.message_count == found.messages


def test_chunks_are_copied_byte_for_byte(part):
    old, new = part.read_bytes(), recover(part).path.read_bytes()
    copied = [old[start:end] for start, end in chunk_spans(old)]
    assert len(copied) == 30
    assert all(chunk in new for chunk in copied)


def test_the_last_reported_losses_become_the_summary(tmp_path):
    whole = write_small_log(tmp_path / "whole.mcap")
    losses = {"laser_x": {"samples": 7}}

    def fill(writer):
        health = writer.register_channel("health", "json", 0)
        for lost in (3, 7):
            note = ch.pack_note({"kind": "health", "losses": {"laser_x": {"samples": lost}}})
            writer.add_message(health, 10, 10, 0, note)

    part = tmp_path / "cut.mcap.part"
    part.write_bytes(written(fill, finish=False))
    with open_log(recover(part).path) as log:
        assert json.loads(log.metadata["summary"]["losses"]) == losses
    with open_log(recover(whole).path) as new, open_log(whole) as old:  # a finished log keeps its own summary
        assert new.path.name == "whole.recovered.mcap"
        assert new.metadata["summary"] == old.metadata["summary"]


def test_a_damaged_finished_log(tmp_path):
    data = bytearray(WHOLE.data)
    _, end = chunk_spans(WHOLE.data)[4]
    data[end - 4] ^= 8
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    found = recover(path, tmp_path / "good.mcap")
    assert [place.messages for place in found.missing if place.messages] == [53]
    assert found.messages == 30 * 52 + 8 - 53
    with open_log(found.path) as log:
        assert log.metadata["recovered"]["missing_messages"] == "53"
    again = recover(found.path)
    with open_log(again.path) as log:
        assert log.metadata["recovered earlier"]["origin"] == "run.mcap"
        assert log.metadata["recovered"]["origin"] == "good.mcap"
        assert again.missing == ()


def test_messages_whose_channel_was_lost_are_kept(tmp_path):
    def fill(writer):
        tacho = add_channel(writer)
        for number in range(3):
            writer.add_block(tacho, 10 + number, 10 + number, number, marks([number]))
            writer.flush()

    data = bytearray(written(fill, finish=False))
    data[chunk_spans(bytes(data))[0][1] - 1] ^= 1  # the only chunk with definitions
    part = tmp_path / "run.mcap.part"
    part.write_bytes(data)
    with open_log(part) as log:
        assert any("channel 1" in str(place) for place in log.missing)
    found = recover(part)
    assert found.messages == 2
    with open_log(found.path) as log:
        assert log.count("unknown/1") == 2
        assert log.verify() == []


def test_nothing_is_written_over(part):
    existing = part.with_name("run.mcap")
    existing.write_bytes(b"precious")
    with pytest.raises(LogError, match="exists already"):
        recover(part)
    assert existing.read_bytes() == b"precious"
    with pytest.raises(LogError, match="exists already"):
        recover(part, part)


def test_a_file_that_appears_meanwhile_is_not_written_over(part):
    out = part.with_name("run.mcap")

    def make(share):
        if not out.exists():
            out.write_bytes(b"precious")

    with pytest.raises(LogError, match="exists already"):
        recover(part, out, make)
    assert out.read_bytes() == b"precious"
    assert not list(part.parent.glob("*.recovering"))


@pytest.mark.parametrize("data", [b"", b"no log at all, but long enough", CUT.data[:60]])
def test_nothing_to_recover(tmp_path, data):
    part = tmp_path / "run.mcap.part"
    part.write_bytes(data)
    with pytest.raises(LogError, match="nothing can be recovered"):
        recover(part)
    assert list(tmp_path.iterdir()) == [part]
    with pytest.raises(LogError, match="check the path"):
        recover(tmp_path / "nowhere.mcap.part")


def test_a_file_that_is_still_written_is_refused(part):
    grown = []

    def grow(share):
        if not grown:
            grown.append(True)
            with part.open("ab") as stream:
                stream.write(bytes(1000))

    with pytest.raises(LogError, match=r"its recorder will name it run\.mcap"):
        recover(part, progress=grow)
    assert list(part.parent.iterdir()) == [part]
    for name in ("a.mcap", "so-far.mcap"):
        grown.clear()
        found = recover(part, part.with_name(name), grow)
        assert any("still being written: it grew by 1000 bytes" in str(place) for place in found.missing)


def test_a_full_disk_leaves_nothing_behind(part, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.os, "fsync", full)
    with pytest.raises(RecordingError, match="The disk is full"):
        recover(part)
    assert list(part.parent.iterdir()) == [part]


def test_the_folder_is_made_and_the_disk_is_only_full_when_it_is(part, tmp_path):
    out = tmp_path / "saved" / "today" / "run.mcap"
    assert recover(part, out).path == out
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(RecordingError, match="Give another place") as found:
        recover(part, tmp_path / "file" / "run.mcap")
    assert "full" not in str(found.value)


def test_a_recovered_log_ends_in_mcap(part, tmp_path):
    with pytest.raises(LogError, match=r"ends in \.mcap, got 'out\.txt'"):
        recover(part, tmp_path / "out.txt")
    assert list(tmp_path.iterdir()) == [part]


def test_without_hard_links_it_is_renamed(part, monkeypatch):
    def refused(*_):
        raise OSError(1, "not permitted")

    monkeypatch.setattr(module.os, "link", refused)
    with open_log(recover(part).path) as log:
        assert log.verify() == []
    with pytest.raises(LogError, match="exists already"):
        recover(part)


def test_the_command_prints_what_is_missing(part, capsys):
    assert command(part, json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["messages"] == 30 * 52 + 8
    assert "not finished or is cut" in found["missing"][0]["sentence"]
    os.remove(part.with_name("run.mcap"))
    assert command(part) == 0
    out = capsys.readouterr()
    assert out.out.startswith("missing    ")
    assert "1568 messages" in out.err


def test_the_crc_of_every_copied_chunk_is_there(part):
    data = recover(part).path.read_bytes()
    assert all(int.from_bytes(data[start + 33 : start + 37], "little") for start, _ in chunk_spans(data))


def test_a_recording_killed_before_its_first_flush_is_recovered_with_its_facts(tmp_path):
    log = LogFile(tmp_path / "run.mcap", {"test": "point-A"}, {"rig.json": b"{}"}, ("laser_x",), 10**18)
    log.close()
    found = recover(log.part)
    assert (found.messages, found.seconds) == (0, 0.0)
    with open_log(found.path) as recovered:
        assert recovered.metadata["run"] == {"test": "point-A"}
        assert recovered.attachments == {"rig.json": b"{}"}
        assert recovered.verify() == []
        assert (recovered.start_ns, recovered.end_ns) == (0, 0)
