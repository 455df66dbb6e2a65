"""A recovered log is never treated as complete: earlier losses are in its `missing`, its losses, its run."""

from __future__ import annotations

import json
from pathlib import Path

import mcap.writer
import pytest
from cyclopts import App

from benchmarks.damaged_logs import chunk_spans, make_shape
from daq.catalogue import Catalogue
from daq.drivers.devices import make_pipelines
from daq.items import RX, Batch
from daq.log import lost_before as module, open_log, opened, recover
from daq.log.file import LogFile
from daq.log.losses import losses_of
from daq.log.lost_before import lost_metadata, read_lost
from daq.mcap.missing import Missing
from daq.replay.checking import check_log
from daq.signals.completeness import missing_warnings
from daq.signals.run import load_run
from rig_cli.logs import log as log_command
from rig_configs import load_rig
from tests.daq.catalogue.test_catalogue import make_log
from tests.daq.mcap.written import foreign
from tests.daq.small_log import device_bytes

START = 1_700_000_000_000_000_000
LOST = 20 * (40 + 40 + 10 + 1 + 1 + 4)  # messages of one chunk: 20 steps of both lasers, angles, mark, motor, raw

app = App(name="rig")
app.command(log_command)


def run_command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = app([str(a) for a in arguments], exit_on_error=False, print_error=True, result_action="return_value")
    return code, capsys.readouterr().out


def in_three_chunks(path: Path) -> Path:
    """An intact log of 0.6 s; made without the recorder, whose chunks end at varying places."""
    rig = load_rig("virtual")
    pipelines = make_pipelines(rig.devices, {})
    attachments = {"rig.json": rig.snapshot_json(), "identities.json": b"{}"}
    with LogFile(path, {"test": "small"}, attachments, tuple(pipelines), START) as log:
        for i, (device, data) in enumerate(device_bytes(60)):
            host_ns = START + 10**7 * (i // 4)
            log.raw(device, RX, data, host_ns)
            for item in pipelines[device].feed(RX, data, host_ns):
                if isinstance(item, Batch):
                    log.batch(item, host_ns)
                else:
                    log.event(item, host_ns)
            if i % 80 == 79:
                log.flush()
        return log.finish({"losses": {}})


def holed(folder: Path) -> Path:
    """A finished log with a damaged chunk in its middle."""
    path = in_three_chunks(folder / "run.mcap")
    damage(path)
    return path


def damage(path: Path) -> None:
    """Damage the last chunk but one."""
    data = bytearray(path.read_bytes())
    data[chunk_spans(bytes(data))[-2][1] - 4] ^= 8
    path.write_bytes(data)


@pytest.fixture
def recovered(tmp_path: Path) -> Path:
    return recover.recover(holed(tmp_path), tmp_path / "saved" / "good.mcap").path


def test_an_opened_log_lists_what_is_missing(recovered: Path) -> None:
    with open_log(recovered) as log:
        (place,) = log.missing
        assert (log.complete, log.lost_before) == (False, [place])
        assert place.text.startswith("lost before it was recovered: from byte ")
        assert "of run.mcap: a chunk" in place.text
        assert (place.byte_start, place.byte_end) == (None, None)
        assert place.messages == LOST
        assert "motor" in place.topics
        assert None not in (place.start_ns, place.end_ns)
        assert log.verify() == []  # this file itself is intact
        assert log.missing == [place]


def test_the_end_that_a_cut_log_lacks_is_among_it(tmp_path: Path) -> None:
    with open_log(recover.recover(make_log(tmp_path / "run.mcap", cut=True)).path) as log:
        (place,) = log.missing
        assert "not finished or is cut" in place.text
        assert (place.messages, place.start_ns, place.end_ns) == (None, log.end_ns, None)


def test_a_second_recovery_keeps_what_was_lost_before_the_first(tmp_path: Path) -> None:
    path, counts = tmp_path / "run.mcap", []
    path.write_bytes(make_shape("zstd", True, 30, 50, 1, 2**18).data)
    for _ in range(2):
        data = bytearray(path.read_bytes())
        data[chunk_spans(bytes(data))[4][1] - 4] ^= 8
        path.write_bytes(data)
        found = recover.recover(path)
        path, counts = found.path, counts + [place.messages for place in found.missing if place.messages]
    with open_log(path) as log:
        assert log.missing == log.lost_before
        assert [place.messages for place in log.missing if place.messages] == counts
        assert len(counts) == 2
        assert [str(place).count("lost before") for place in log.missing] == [1] * len(log.missing)
        assert " of run.mcap: " in str(log.missing[0])
        assert " of run.recovered.mcap: " in str(log.missing[-1])


def test_the_losses_and_the_run_count_it(recovered: Path) -> None:
    with open_log(recovered) as log:
        losses = losses_of(log)
        assert losses.by_device["log"] == {"missing_messages": LOST}
        assert (losses.total, losses.words()) == (LOST, f"log {LOST} missing messages")
        sentences = [str(place) for place in log.missing]
    run = load_run(recovered)
    assert run.losses["log.missing_messages"] == LOST
    assert (run.metadata["missing"], run.metadata["complete"]) == (sentences, False)
    assert missing_warnings([run]) == [f"good.mcap: the log is incomplete: {sentences[0]}"]


def test_a_run_contains_the_damage_of_its_log(tmp_path: Path) -> None:
    run = load_run(holed(tmp_path))
    assert run.losses["log.missing_messages"] == LOST
    assert len(run.metadata["missing"]) == 1
    sound = load_run(in_three_chunks(tmp_path / "sound.mcap"))
    assert "log.missing_messages" not in sound.losses
    assert sound.metadata["missing"] == []
    assert missing_warnings([sound]) == []


def test_the_command_prints_it_and_finds_the_file_itself_sound(
    recovered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out = run_command(capsys, "log", recovered)
    assert code == 0
    assert "recovered, not whole; of what it holds every byte checked" in out
    assert "lost before it was recovered" in out
    assert f"log {LOST} missing messages" in out
    code, out = run_command(capsys, "log", recovered, "--json")
    found = json.loads(out)
    assert (code, found["complete"], found["state"]) == (0, False, "recovered")
    assert found["missing"] == found["lost_before"] != []
    assert (found["unchecked"], found["losses"]["total"]) == ([], LOST)
    damage(recovered)
    assert run_command(capsys, "log", recovered)[0] == 1


def test_the_catalogue_lists_it_as_not_whole(recovered: Path) -> None:
    (entry,) = Catalogue(recovered.parent).search()
    assert (entry.state, entry.complete, entry.lost) == ("recovered", False, LOST)
    assert "lost before it was recovered" in entry.why


def test_a_log_that_lost_nothing_is_whole_after_recovery(tmp_path: Path) -> None:
    path = in_three_chunks(tmp_path / "run.mcap")
    with open_log(recover.recover(path).path) as log:
        assert (log.complete, log.missing) == (True, [])


def test_the_check_ends_where_the_recovered_log_lacks_something(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_log(in_three_chunks(tmp_path / "run.mcap")) as log:
        hole = Missing("a chunk", 1, 2, log.start_ns + 3 * 10**8, log.start_ns + 4 * 10**8, ("raw/laser_x",), 5)
        lost = {"recovered": lost_metadata([hole], "run.mcap.part", [])}
        monkeypatch.setattr(opened, "read_lost", lambda _: read_lost(lost))
        found = check_log(log)
    assert found.until_ns == hole.start_ns
    assert found.identical
    assert any("lost before it was recovered" in note for note in found.notes)


@pytest.mark.parametrize("places", ["[", "5", '[{"text": 3}]', "[" * 100_000, '[{"text": "t", "topics": 4}]'])
def test_places_that_cannot_be_read_are_reported_by_their_sentences(places: str) -> None:
    found = {"recovered": {"places": places, "missing": "one\ntwo"}}
    assert [str(place) for place in read_lost(found)] == [
        "lost before it was recovered: one",
        "lost before it was recovered: two",
    ]
    assert len(read_lost({"recovered": {"places": places}})) == 1
    assert read_lost({"recovered": {}}) == ()


def test_too_many_places_become_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_PLACES", 3)
    lost = [Missing("a chunk", k, k + 1, k, k + 5, ("b", "a")[k % 2 : k % 2 + 1], 2) for k in range(6)]
    found = read_lost({"recovered": lost_metadata(lost, "run.mcap", [])})
    assert [place.messages for place in found] == [2, 2, 8]
    assert (found[-1].start_ns, found[-1].end_ns, found[-1].topics) == (2, 10, ("a", "b"))
    assert found[-1].text == "4 more places"
    unknown = lost_metadata([*lost, Missing("the end", 9)], "run.mcap", [])
    assert read_lost({"recovered": unknown})[-1] == Missing("5 more places", topics=("a", "b"))


def test_a_recovered_file_of_another_program_counts_no_losses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fill(writer: mcap.writer.Writer) -> None:
        channel = writer.register_channel("note", "json", 0)
        for number in range(40):
            writer.add_message(channel, number, b'{"number": %d}' % number, number)

    path = tmp_path / "foreign.mcap"
    path.write_bytes(foreign(fill, chunk_size=200))
    made = recover.recover(path).path
    for name in (path.name, made.name):
        (entry,) = (entry for entry in Catalogue(tmp_path).search() if entry.path == name)
        assert (entry.state, entry.lost) == ("foreign", None)
        code, out = run_command(capsys, "log", tmp_path / name)
        assert code == 0
        assert "unknown: it counts none" in out
