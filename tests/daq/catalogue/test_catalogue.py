"""The catalogue: facts of every kind of file, search, verdicts; any content of the cache gives the same results."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mcap.writer
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.catalogue import Catalogue, Entry, Query, cache, facts, parse_instant, search
from daq.catalogue.cache import NAME, CachedFacts, Stamp
from daq.catalogue.query import Sort
from daq.channels import TACHO
from daq.errors import LogError, RecordingError
from daq.items import Batch
from daq.log.file import LogFile
from daq.log.verdicts import SUFFIX, LoggedVerdict, digest_of, keep_verdict, verdict_of
from daq.mcap.writer import BlockWriter
from tests.daq.mcap.written import foreign, written
from tests.effort import cases

T0 = 1_700_000_000_000_000_000
LATER_NS = 10**10


def make_log(path: Path, marks: int = 3, losses: dict[str, Any] | None = None, cut: bool = False, **run: str) -> Path:
    """A small log of tachometer marks, one per second."""
    with LogFile(path, run, {}, (), T0) as log:
        turns = np.arange(marks)
        columns = {"revolutions": turns, "node_time_us": 10**6 * turns}
        log.batch(Batch(TACHO, T0 + 10**9 * turns, turns.astype(np.uint32), columns), T0 + 10**9 * turns)
        log.flush()
        return log.part if cut else log.finish({"losses": losses or {}, "settled": True})


def settled_catalogue(folder: Path) -> Catalogue:
    """A catalogue whose clock is so late that every file may be cached."""
    return Catalogue(folder, lambda: time.time_ns() + LATER_NS)


def only(folder: Path) -> Entry:
    (entry,) = settled_catalogue(folder).search()
    return entry


def without_cache(folder: Path) -> list[Entry]:
    with patch.object(cache, "load", return_value={}), patch.object(cache, "save"):
        return Catalogue(folder).entries()


def judged(log: Path, verdict: str = "pass") -> LoggedVerdict:
    return LoggedVerdict(verdict=verdict, judged_at="2026-03-01T10:00:00Z", digest=digest_of(log), state="I", point="A")


# --- facts -------------------------------------------------------------------------------------------------------


def test_facts_of_a_finished_log(tmp_path: Path) -> None:
    facts = {
        "rig": "bench",
        "test": "point-A",
        "point": "A",
        "note": "new spring",
        "software": "0.1.0",
        "parameters": "parameters.toml sha256:1a2b3c4d",
        "started": "2026-03-01T10:00:00Z",
    }
    losses = {"laser_x": {"samples": 12, "invalid": 3}, "encoder": {"radio_frames": 0}}
    path = make_log(tmp_path / "deep" / "down" / "run.mcap", marks=5, losses=losses, **facts)
    entry = only(tmp_path)
    found = entry.model_dump()
    assert {name: found[name] for name in facts} == facts
    assert (entry.path, entry.size_bytes) == ("deep/down/run.mcap", path.stat().st_size)
    assert (entry.state, entry.complete, entry.why) == ("finished", True, "")
    assert entry.started_ns == 1_772_359_200 * 10**9
    assert (entry.duration_s, entry.messages) == (4.0, 5)
    assert (entry.lost, entry.losses, entry.losses_from) == (12, losses, "summary")
    assert (entry.outcome, entry.verdict, entry.judged) == ({"settled": True}, "", None)


def test_start_is_the_first_message_if_the_run_does_not_state_it(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap", started="teatime")
    assert only(tmp_path).started_ns == T0
    assert only(tmp_path).started == "2023-11-14T22:13:20Z"


def test_a_cut_log(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap", cut=True, rig="bench")
    entry = only(tmp_path)
    assert (entry.path, entry.state, entry.complete, entry.rig) == ("run.mcap.part", "unfinished", False, "bench")
    assert entry.messages == 3
    assert "not finished" in entry.why
    assert str(tmp_path) not in entry.why


def test_a_damaged_log(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap", rig="bench")
    data = bytearray(path.read_bytes())
    data[-20] ^= 1  # in the footer, which the summary's CRC covers
    path.write_bytes(data)
    entry = only(tmp_path)
    assert (entry.state, entry.complete) == ("damaged", False)
    assert entry.why


def with_facts(writer: BlockWriter | mcap.writer.Writer, **tables: dict[str, str]) -> None:
    for name, texts in tables.items():
        writer.add_metadata(name, texts)


def test_a_recovered_log_names_its_origin(tmp_path: Path) -> None:
    origin = {"origin": "run-1.mcap.part"}
    data = written(lambda writer: with_facts(writer, run={"rig": "bench", **origin}, recovered=origin))
    (tmp_path / "run.mcap").write_bytes(data)
    entry = only(tmp_path)
    assert (entry.state, entry.complete, entry.origin) == ("recovered", True, "run-1.mcap.part")
    assert (entry.messages, entry.started_ns, entry.duration_s) == (0, None, 0.0)


def of_another_program(path: Path) -> None:
    path.write_bytes(foreign(lambda writer: with_facts(writer, summary={"losses": '{"a": 7}'}), "robot recorder 7"))


def broken_link(path: Path) -> None:
    path.symlink_to("nowhere")


def named_pipe(path: Path) -> None:
    os.mkfifo(path)


on_posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes, and links for few")


@pytest.mark.parametrize(
    ("make", "state", "why"),
    [
        (of_another_program, "foreign", "an MCAP file of robot recorder 7"),
        (lambda path: path.write_bytes(b""), "unreadable", "expected an MCAP log"),
        (lambda path: path.write_text("time;x\n0;1\n"), "unreadable", "expected an MCAP log"),
        pytest.param(broken_link, "unreadable", "expected a file", marks=on_posix),
        pytest.param(named_pipe, "unreadable", "expected a file", marks=on_posix),
    ],
)
def test_a_file_that_is_not_a_log_is_listed_as_what_it_is(
    tmp_path: Path, make: Callable[[Path], None], state: str, why: str
) -> None:
    make(tmp_path / "odd.mcap")
    make_log(tmp_path / "run.mcap")
    odd, run = settled_catalogue(tmp_path).search(Query(sort="path"))
    assert (odd.state, odd.lost) == (state, None)
    assert why in odd.why
    assert "\n" not in odd.why
    assert run.state == "finished"
    assert settled_catalogue(tmp_path).search(Query(sort="path")) == [odd, run]


@pytest.mark.parametrize("losses", ["[]", "7", "{", '{"a": 7}', '{"a": {"b": null}}', '{"a": {"b": "many"}}'])
def test_losses_of_another_form_are_unknown(tmp_path: Path, losses: str) -> None:
    hostile = {
        "losses": losses,
        "deep": "[" * 10**5,
        "nan": "NaN",
        "lone": '"\\ud800"',
        "long": '"' + "x" * 10**5 + '"',
    }
    data = written(lambda writer: with_facts(writer, run={"rig": "bench"}, summary=hostile))
    (tmp_path / "run.mcap").write_bytes(data)
    entry = only(tmp_path)
    assert (entry.rig, entry.state, entry.lost) == ("bench", "finished", None)
    assert (entry.outcome["nan"], entry.outcome["lone"]) == (None, "?")
    assert max(len(str(value)) for value in entry.outcome.values()) <= 2000
    assert only(tmp_path) == entry  # also from the cache


def test_a_folder_is_needed(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="expected a folder"):
        Catalogue(tmp_path / "nowhere")
    assert Catalogue(tmp_path).search() == []
    assert not list(tmp_path.iterdir())  # an empty folder needs no cache


# --- search ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    folder = tmp_path_factory.mktemp("shelf")
    make_log(
        folder / "a.mcap",
        2,
        rig="bench",
        test="point-A",
        point="A",
        started="2026-03-01T10:00:00Z",
        note="New spring",
        parameters="p.toml sha256:11",
    )
    make_log(
        folder / "b.mcap",
        4,
        {"laser_x": {"samples": 5}},
        rig="bench",
        test="point-AB",
        point="AB",
        started="2026-03-02T10:00:00Z",
    )
    make_log(
        folder / "sub" / "c.mcap",
        3,
        {"laser_x": {"invalid": 5}},
        rig="tower",
        test="run-up",
        started="2026-03-03T10:00:00Z",
    )
    make_log(folder / "d.mcap", cut=True, rig="tower", test="run-up", note="spring broke", started="2026-03-04T10:00Z")
    keep_verdict(folder / "a.mcap", judged(folder / "a.mcap"))
    keep_verdict(folder / "b.mcap", judged(folder / "b.mcap", "not settled"))
    (folder / "e.mcap").write_bytes(b"junk")
    return settled_catalogue(folder)


@pytest.mark.parametrize(
    ("query", "names"),
    [
        ({}, "dcbae"),
        ({"words": ("SPRING",)}, "da"),
        ({"words": ("spring", "tower")}, "d"),
        ({"words": ("sub/",)}, "c"),
        ({"words": ("point-a",)}, "ba"),
        ({"rig": "Tow"}, "dc"),
        ({"test": "point"}, "ba"),
        ({"point": "a"}, "a"),
        ({"note": "broke"}, "d"),
        ({"parameters": "sha256:11"}, "a"),
        ({"verdict": "pass"}, "a"),
        ({"verdict": "not"}, "b"),
        ({"verdict": "none"}, "dce"),
        ({"lost": True}, "b"),
        ({"lost": False}, "dcae"),
        ({"complete": True}, "cba"),
        ({"complete": False}, "de"),
        ({"since_ns": parse_instant("2026-03-02T10:00Z", datetime.now())}, "dcb"),
        ({"until_ns": parse_instant("2026-03-02T10:00Z", datetime.now())}, "a"),
        ({"words": ("nothing", "like", "it")}, ""),
        ({"reverse": True}, "eabcd"),
    ],
)
def test_search(shelf: Catalogue, query: dict[str, Any], names: str) -> None:
    found = "".join(Path(entry.path).name[0] for entry in shelf.search(Query(**query)))
    assert found == names


@pytest.mark.parametrize("sort", Sort.__args__)
def test_sorting_and_its_reverse(shelf: Catalogue, sort: Sort) -> None:
    keys: dict[str, Callable[[Entry], Any]] = {
        "started": lambda e: -(e.started_ns or 0),
        "path": lambda e: e.path,
        "rig": lambda e: e.rig,
        "test": lambda e: e.test.lower(),
        "point": lambda e: e.point,
        "duration": lambda e: -e.duration_s,
        "size": lambda e: -e.size_bytes,
        "lost": lambda e: -(e.lost or 0),
        "verdict": lambda e: e.verdict,
    }
    there = [keys[sort](entry) for entry in shelf.search(Query(sort=sort))]
    back = [keys[sort](entry) for entry in shelf.search(Query(sort=sort, reverse=True))]
    assert len(set(there)) > 1
    assert there == sorted(there) == back[::-1]


NOON = datetime(2026, 3, 10, 12)


@pytest.mark.parametrize(
    ("text", "end", "instant"),
    [
        ("2026-03-01", False, datetime(2026, 3, 1)),
        ("2026-03-01", True, datetime(2026, 3, 2)),
        ("20260301", True, datetime(2026, 3, 2)),
        ("2026-03-01T10:30", True, datetime(2026, 3, 1, 10, 30)),
        ("2026-03-01t10:30:00.5", False, datetime(2026, 3, 1, 10, 30, 0, 500_000)),
        ("2026-03-01T10:30+02:00", False, datetime.fromisoformat("2026-03-01T08:30Z")),
        ("today", False, datetime(2026, 3, 10)),
        ("Yesterday", True, datetime(2026, 3, 10)),
        ("3d", False, NOON - timedelta(days=3)),
        ("1.5 h", True, NOON - timedelta(hours=1.5)),
        ("30min", False, NOON - timedelta(minutes=30)),
        ("2w", False, NOON - timedelta(weeks=2)),
    ],
)
def test_instants_as_people_write_them(text: str, end: bool, instant: datetime) -> None:
    assert parse_instant(text, NOON, end) == round(instant.timestamp() * 1e6) * 1000


@pytest.mark.parametrize("text", ["", "soon", "3 parsecs", "2026-13-01", "-3d", "9999999999999w", "10:30"])
def test_other_words_are_no_instants(text: str) -> None:
    with pytest.raises(ValueError, match="expected a date like"):
        parse_instant(text, NOON)


# --- verdicts ----------------------------------------------------------------------------------------------------


def test_a_verdict_is_of_one_log(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap", note="one")
    assert verdict_of(path) is None
    verdict = judged(path)
    assert keep_verdict(path, verdict).name == "run.mcap.verdict.json"
    assert verdict_of(path) == verdict
    assert (only(tmp_path).verdict, only(tmp_path).judged) == ("pass", verdict)
    keep_verdict(path, judged(path, "fail"))
    assert only(tmp_path).verdict == "fail"
    path.unlink()
    make_log(path, note="two")
    assert only(tmp_path).verdict == "stale"
    (tmp_path / f"run.mcap{SUFFIX}").unlink()
    assert (only(tmp_path).verdict, only(tmp_path).judged) == ("", None)
    assert sorted(p.name for p in tmp_path.iterdir()) == [NAME, "run.mcap"]


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b'{"verdict": "pass"}', b"\xff", b" " * 2**21])
def test_what_is_no_verdict(tmp_path: Path, text: bytes) -> None:
    path = make_log(tmp_path / "run.mcap")
    (tmp_path / f"run.mcap{SUFFIX}").write_bytes(text)
    with pytest.raises(LogError, match=r"verdict\.json: expected a verdict"):
        verdict_of(path)
    entry = only(tmp_path)
    assert (entry.state, entry.verdict, entry.judged) == ("finished", "unreadable", None)


def test_a_verdict_refuses_keys_it_does_not_know(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap")
    text = judged(path).model_dump_json().replace('"why"', '"reason"')
    (tmp_path / f"run.mcap{SUFFIX}").write_text(text)
    with pytest.raises(LogError, match="reason"):
        verdict_of(path)


def test_a_verdict_that_cannot_be_kept_leaves_nothing_behind(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap")
    (tmp_path / f"run.mcap{SUFFIX}").mkdir()
    with pytest.raises(RecordingError, match="cannot be written next to"):
        keep_verdict(path, judged(path))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap", f"run.mcap{SUFFIX}"]
    with pytest.raises(LogError, match="cannot be read"):
        digest_of(tmp_path / "nowhere")


def test_a_log_is_hashed_once(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap")
    keep_verdict(path, judged(path))
    assert only(tmp_path).verdict == "pass"
    keep_verdict(path, judged(path, "fail"))
    with patch.object(search, "digest_of", side_effect=AssertionError("hashed again")):
        assert only(tmp_path).verdict == "fail"


# --- the cache ---------------------------------------------------------------------------------------------------


def read_nothing() -> Any:
    return patch.object(facts, "read_entry", side_effect=AssertionError("a file was read"))


def test_what_was_read_is_remembered(tmp_path: Path) -> None:
    for number in range(3):
        make_log(tmp_path / f"{number}.mcap", number + 1)
    first = settled_catalogue(tmp_path).entries()
    with read_nothing():
        assert settled_catalogue(tmp_path).entries() == first
    (tmp_path / "1.mcap").unlink()
    make_log(tmp_path / "3.mcap", 9)
    shares: list[float] = []
    again = settled_catalogue(tmp_path).entries(shares.append)
    assert [entry.messages for entry in again] == [1, 3, 9]
    assert shares == [0.0]
    assert set(cache.load(tmp_path)) == {"0.mcap", "2.mcap", "3.mcap"}


def test_a_file_that_just_changed_is_read_again(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap")
    Catalogue(tmp_path).entries()
    with read_nothing(), pytest.raises(AssertionError, match="a file was read"):
        Catalogue(tmp_path).entries()


def test_when_a_change_would_show() -> None:
    looked = 10**18
    assert Stamp(1, looked - 3 * 10**9, looked - 3 * 10**9).settled_by(looked)
    assert not Stamp(1, looked - 3 * 10**9, looked - 10**9).settled_by(looked)
    assert not Stamp(1, looked + 10**9, looked - 3 * 10**9).settled_by(looked)


def spoil(file: Path, how: str) -> None:
    data = file.read_bytes()
    if how == "cut":
        file.write_bytes(data[: len(data) // 2])
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "junk":
        file.write_bytes(b"1 00000000\n" + bytes(5000))
    elif how == "note":
        assert b"true note" in data
        file.write_bytes(data.replace(b"true note", b"fake note"))
    elif how == "version":
        file.write_bytes(b"99" + data[1:])
    else:
        file.write_bytes(f"{cache.VERSION} {zlib.crc32(how.encode()):08x}\n{how}".encode())


OTHER = ["[" * 10**5, "7", '{"run.mcap": 7}', '{"run.mcap": {"stamp": [1, 2], "entry": {}}}']


@pytest.mark.parametrize("how", ["cut", "empty", "junk", "note", "version", *OTHER])
def test_an_invalid_cache_is_made_again(tmp_path: Path, how: str) -> None:
    make_log(tmp_path / "run.mcap", note="true note")
    first = only(tmp_path)
    spoil(tmp_path / NAME, how)
    assert cache.load(tmp_path) == {}
    assert only(tmp_path) == first
    with read_nothing():
        assert only(tmp_path) == first


def test_rows_of_another_process_are_kept_and_the_newer_one_wins(tmp_path: Path) -> None:
    def row(looked_ns: int, text: str) -> CachedFacts:
        entry = Entry(path=text, size_bytes=1, state="finished")
        return CachedFacts(stamp=Stamp(1, 2, 3), verdict_stamp=None, looked_ns=looked_ns, digest="", entry=entry)

    cache.save(tmp_path, {"a": row(5, "new"), "b": row(1, "b"), "gone": row(1, "x")}, ())
    cache.save(tmp_path, {"a": row(4, "old"), "c": row(1, "c")}, {"gone"})
    assert {path: row.entry.path for path, row in cache.load(tmp_path).items()} == {"a": "new", "b": "b", "c": "c"}


def test_what_a_killed_process_left_is_swept_up(tmp_path: Path) -> None:
    old, new = tmp_path / f"{NAME}.00.new", tmp_path / f"{NAME}.11.new"
    for file in (old, new):
        file.write_bytes(b"half")
    os.utime(old, (0, 0))
    cache.save(tmp_path, {}, ())
    assert (old.exists(), new.exists()) == (False, True)


def test_a_folder_that_cannot_be_written_to(tmp_path: Path) -> None:
    make_log(tmp_path / "run.mcap")
    (tmp_path / NAME).mkdir()  # a folder of this name cannot be replaced by a file, also for root
    found = settled_catalogue(tmp_path)
    first = found.search()
    assert [entry.messages for entry in first] == [3]
    assert "cannot be cached" in found.cache_trouble
    assert sorted(p.name for p in tmp_path.iterdir()) == [NAME, "run.mcap"]
    with read_nothing():
        assert found.search() == first
    (tmp_path / NAME).rmdir()
    make_log(tmp_path / "two.mcap")
    assert len(found.search()) == 2
    assert found.cache_trouble == ""
    with read_nothing():
        assert len(settled_catalogue(tmp_path).search()) == 2


def test_a_recording_that_ends_during_a_look_is_found_under_its_name(tmp_path: Path) -> None:
    part = make_log(tmp_path / "run.mcap", cut=True)
    read = facts.read_entry

    def rename_first(file: Path, path: str, size_bytes: int) -> Entry:
        if part.exists():
            part.rename(tmp_path / "run.mcap")
        return read(file, path, size_bytes)

    with patch.object(facts, "read_entry", rename_first):
        assert [entry.path for entry in settled_catalogue(tmp_path).search()] == ["run.mcap"]


NAMES = st.sampled_from(["a.mcap", "b.mcap", "sub/c.mcap"])
WHAT = st.sampled_from(["write", "cut", "remove", "judge", "flip", "drop", "spoil", "look"])
OPERATIONS = st.lists(st.tuples(WHAT, NAMES, st.integers(0, 9)), max_size=12)


@given(OPERATIONS)
@settings(max_examples=cases(20, 40))
def test_the_cache_changes_no_answer(
    tmp_path_factory: pytest.TempPathFactory, operations: list[tuple[str, str, int]]
) -> None:
    folder = tmp_path_factory.mktemp("random")
    look = settled_catalogue(folder)
    for step, (what, name, number) in enumerate(operations):
        file = folder / name
        if what == "write":
            file.unlink(missing_ok=True)
            file.with_name(file.name + ".part").unlink(missing_ok=True)
            make_log(file, note=f"note {number}")
        elif what == "cut":
            file.with_name(file.name + ".part").unlink(missing_ok=True)
            file.unlink(missing_ok=True)
            make_log(file, marks=number, cut=True)
        elif what == "remove":
            file.unlink(missing_ok=True)
        elif what == "judge" and file.exists():
            keep_verdict(file, judged(file, f"verdict {number}"))
        elif what == "flip" and file.exists():
            data = bytearray(file.read_bytes())
            data[len(data) * number // 10] ^= 1
            file.write_bytes(data)
        elif what == "drop":
            (folder / NAME).unlink(missing_ok=True)
        elif what == "spoil" and (folder / NAME).exists():
            data = bytearray((folder / NAME).read_bytes())
            data[len(data) * number // 10] ^= 0x40
            (folder / NAME).write_bytes(data)
        if file.exists() and what in ("write", "flip"):
            os.utime(file, ns=(T0 + step, T0 + step))  # the coarse clock of a file system advances between two changes
        if what == "look":
            assert look.entries() == without_cache(folder)
    assert look.entries() == without_cache(folder)
    assert settled_catalogue(folder).entries() == without_cache(folder)


SEARCHER = """
import sys, time
from pathlib import Path
from daq.catalogue import Catalogue
seen = 0
for turn in range(int(sys.argv[2])):
    for entry in Catalogue(sys.argv[1], lambda: time.time_ns() + 10**10).search():
        assert entry.state == "finished", entry
        assert entry.note == "note of " + Path(entry.path).name, entry
        seen += 1
print(seen)
"""


def test_many_processes_search_while_logs_come_and_go_and_the_cache_is_spoilt(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()

    def add(number: int) -> None:
        made = make_log(tmp_path / f"{number}.mcap", note=f"note of {number}.mcap")
        made.rename(folder / made.name)

    for number in range(20):
        add(number)
    command = [sys.executable, "-c", SEARCHER, str(folder), "12"]
    searchers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    cache, number = folder / NAME, 20
    while any(process.poll() is None for process in searchers):
        add(number)
        (folder / f"{number - 20}.mcap").unlink()
        number += 1
        if number % 3 == 0:
            cache.unlink(missing_ok=True)
        elif number % 3 == 1 and cache.exists():
            cache.write_bytes(b"1 00000000\n{}")
    counts = [int(process.communicate()[0] or 0) for process in searchers]
    assert [process.returncode for process in searchers] == [0, 0, 0]
    assert min(counts) > 0  # how many files vanish before they are read depends on the load of the machine
    assert number > 22
    assert settled_catalogue(folder).entries() == without_cache(folder)
    assert len(without_cache(folder)) == 20
    assert not list(folder.glob(f"{NAME}.*"))


def test_the_calendar_s_ends_are_dates_too() -> None:
    first, last = parse_instant("0001-01-01", NOON), parse_instant("9999-12-31", NOON, end=True)
    assert first < -6 * 10**19
    assert last > 25 * 10**19
    entry = Entry(path="a.mcap", size_bytes=1, state="finished", started_ns=T0)
    assert Query(since_ns=first, until_ns=last).admits(entry)
    assert not Query(since_ns=last).admits(entry)
    assert not Query(until_ns=first).admits(entry)


def test_a_cache_that_may_not_be_read_counts_as_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_log(tmp_path / "run.mcap")
    catalogue = settled_catalogue(tmp_path)
    catalogue.search()

    def refused(self: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(cache.Path, "is_file", refused)
    assert cache.load(tmp_path) == {}


def test_unreadable_folders_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_log(tmp_path / "run.mcap")
    make_log(tmp_path / "locked" / "run.mcap")
    scandir, faults = os.scandir, [PermissionError(13, "Permission denied"), FileNotFoundError(2, "gone")]

    def refused(path: Any) -> Any:
        if str(path).endswith("locked"):
            faults[0].filename = str(path)
            raise faults[0]
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refused)
    catalogue = settled_catalogue(tmp_path)
    for count in (1, 0):  # a folder that was removed meanwhile is not reported
        assert [entry.path for entry in catalogue.search()] == ["run.mcap"]
        assert len(catalogue.unread_folders) == count
        assert all("locked: cannot be read (Permission denied)" in text for text in catalogue.unread_folders)
        faults.pop(0)


def test_a_folder_that_may_not_be_read_or_entered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_log(tmp_path / "run.mcap")

    def refused(*_: object, **__: object) -> Any:
        raise PermissionError(13, "Permission denied", str(tmp_path))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "is_file", refused)
        patched.setattr(os, "lstat", refused)
        entry = only(tmp_path)
    assert (entry.state, entry.why) == ("unreadable", "cannot be read (Permission denied)")
    monkeypatch.setattr(os, "scandir", refused)
    with pytest.raises(LogError, match=r"cannot be read \(Permission denied\)"):
        Catalogue(tmp_path).search()
