"""`rig logs` and `rig log`: what they print, their JSON, exit codes."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import pytest
from cyclopts import App
from rich.console import Console

from daq.catalogue import Entry
from daq.log.file import LogFile
from daq.log.verdicts import LoggedVerdict, digest_of, keep_verdict
from rig_cli import log_table
from rig_cli.log_table import print_logs
from rig_cli.logs import log, logs
from rig_cli.words import length, printable, size
from rig_configs import load_rig
from tests.daq.catalogue.test_catalogue import make_log
from tests.daq.small_log import write_small_log

app = App(name="rig")
app.command(logs)
app.command(log)


@pytest.fixture
def run_rig(capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: object) -> tuple[int, str, str]:
        code = app([str(a) for a in arguments], exit_on_error=False, print_error=True, result_action="return_value")
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    make_log(tmp_path / "a.mcap", rig="bench", test="point-A", point="A", started="2026-03-01T10:00:00Z", note="spring")
    make_log(tmp_path / "b.mcap", losses={"laser_x": {"samples": 7}}, rig="bench", started="2026-03-02T10:00:00Z")
    make_log(tmp_path / "c.mcap", cut=True, rig="tower", started="2026-03-03T10:00:00Z")
    keep_verdict(
        tmp_path / "a.mcap", LoggedVerdict(verdict="pass", judged_at="now", digest=digest_of(tmp_path / "a.mcap"))
    )
    (tmp_path / "junk.mcap").write_bytes(b"junk")
    return tmp_path


# --- rig logs ----------------------------------------------------------------------------------------------------


def test_logs_as_json(run_rig: Any, shelf: Path) -> None:
    code, out, _ = run_rig("logs", shelf, "--json")
    found = json.loads(out)
    assert (code, found["folder"], found["files"]) == (0, str(shelf), 4)
    assert [entry["path"] for entry in found["logs"]] == ["c.mcap.part", "b.mcap", "a.mcap", "junk.mcap"]
    assert set(found["logs"][2]) >= {
        "size_bytes",
        "duration_s",
        "started",
        "losses",
        "lost",
        "verdict",
        "state",
        "note",
    }
    assert found["logs"][2]["verdict"] == "pass"


@pytest.mark.parametrize(
    ("options", "paths"),
    [
        (["spring"], ["a.mcap"]),
        (["--lost"], ["b.mcap"]),
        (["--complete"], ["b.mcap", "a.mcap"]),
        (["--incomplete"], ["c.mcap.part", "junk.mcap"]),
        (["--since", "2026-03-02T00:00Z", "--until", "2026-03-02T23:00Z"], ["b.mcap"]),
        (["--rig", "bench", "--sort", "path", "--reverse"], ["b.mcap", "a.mcap"]),
        (["--point", "a", "--verdict", "pass", "--test", "point", "--note", "spr"], ["a.mcap"]),
        (["--parameters", "sha256"], []),
    ],
)
def test_logs_are_searched(run_rig: Any, shelf: Path, options: list[str], paths: list[str]) -> None:
    code, out, _ = run_rig("logs", shelf, *options, "--json")
    assert (code, [entry["path"] for entry in json.loads(out)["logs"]]) == (0, paths)


def test_the_table_shows_losses_and_damage(run_rig: Any, shelf: Path) -> None:
    code, out, err = run_rig("logs", shelf)
    head, _, *rows = out.rstrip().splitlines()
    assert code == 0
    assert head.split() == [
        "started",
        "log",
        "test",
        "point",
        "length",
        "size",
        "state",
        "lost",
        "verdict",
        "rig",
        "note",
    ]
    assert [row.split("  ")[1] for row in rows[:3]] == ["c.mcap.part", "b.mcap", "a.mcap"]
    assert "unfinished" in rows[0]
    assert "unreadable" in rows[3]
    assert "expected an MCAP log" in rows[3]
    assert "4 logs, 2 not whole, 1 with losses" in err


def test_nothing_found_is_reported(run_rig: Any, shelf: Path, tmp_path: Path) -> None:
    code, out, err = run_rig("logs", shelf, "no such note")
    assert (code, out) == (0, "")
    assert "none of 4 logs" in err
    (tmp_path / "empty").mkdir()
    code, out, err = run_rig("logs", tmp_path / "empty")
    assert (code, out) == (0, "")
    assert "no logs" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--since", "teatime"], "expected a date like"), (["--complete", "--incomplete"], "expected one of")],
)
def test_bad_use_of_logs_is_explained(run_rig: Any, tmp_path: Path, options: list[str], words: str) -> None:
    code, out, err = run_rig("logs", tmp_path, *options)
    assert (code, out) == (2, "")
    assert words in err


def test_a_folder_that_may_not_be_read_is_reported(run_rig: Any, shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (shelf / "locked").mkdir()
    scandir = os.scandir

    def refused(path: Any) -> Any:
        if str(path).endswith("locked"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refused)
    code, out, err = run_rig("logs", shelf, "--json")
    assert code == 0
    assert len(json.loads(out)["unread_folders"]) == 1
    assert "locked: cannot be read (Permission denied), its logs are not listed" in err


def test_a_folder_that_keeps_nothing_is_reported_once(run_rig: Any, shelf: Path) -> None:
    (shelf / ".rig-logs.json").mkdir()
    code, _, err = run_rig("logs", shelf)
    assert code == 0
    assert err.count("cannot be cached") == 1


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
def test_the_table_fits(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], width: int) -> None:
    entry = Entry(
        path="deep/" * 8 + "01-ring-down-x.mcap",
        size_bytes=10**8,
        state="damaged",
        rig="virtual",
        test="ring-down-x",
        point="A",
        note="a note as long as notes are\x1b[31m\nand longer",
        started="2026-03-01T10:00:00Z",
        lost=12345,
        verdict="not settled",
    )
    monkeypatch.setattr(log_table, "stdout_console", lambda: Console(width=width, highlight=False))
    print_logs([entry] * 3, 3, Path("logs"))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert max(map(len, lines)) <= width
    assert not any("\x1b" in line for line in lines)
    assert {"log", "state", "lost"} <= set(lines[0].split())
    assert ("note" in lines[0]) == (width >= 120)


# --- rig log -----------------------------------------------------------------------------------------------------


def test_a_log_as_json(run_rig: Any, tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap", steps=60, opened_at=30, reported=(0, 1))
    keep_verdict(path, LoggedVerdict(verdict="pass", judged_at="now", digest="sha256:" + "0" * 64))
    code, out, _ = run_rig("log", path, "--json")
    found = json.loads(out)
    assert code == 0
    assert set(found) >= {"log", "complete", "missing", "run", "summary", "channels", "events"}
    assert (found["complete"], found["verified"], found["missing"], found["state"]) == (True, True, [], "finished")
    laser = found["channels"]["laser/x"]
    assert laser["samples"] == 2400
    assert laser["rate_Hz"] == pytest.approx(4000, rel=0.01)
    assert found["raw"]["laser_x"]["messages"] == 60
    assert found["raw"]["laser_x"]["bytes_in"] > 60 * 40
    assert found["events"]["lock"] == 2
    assert [line["text"] for line in found["events_alike"] if line["kind"] == "lock"] == [
        "pendulum A released",
        "pendulum B released",
    ]
    assert "all_events" not in found
    assert found["losses"]["source"] == "summary"
    assert found["rig"]["name"] == load_rig("virtual").name
    assert found["rig"]["physical"]["rotor"]["mass_kg"] == 7
    assert set(found["attachments_bytes"]) == {"rig.json", "identities.json", "roles.json"}
    assert found["verdict"]["stale"] is True
    assert found["unreadable"] == []
    _, out, _ = run_rig("log", path, "--events", "--json", "--no-verify")
    everything = json.loads(out)
    assert len(everything["all_events"]) == sum(everything["events"].values())
    assert everything["verified"] is False


def test_a_log_in_words(run_rig: Any, tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap", steps=60, opened_at=30, reported=(0, 1))
    code, out, _ = run_rig("log", path)
    assert code == 0
    for words in (
        "finished, every byte checked",
        "2 400 samples",
        "nothing lost",
        "pendulum A released",
        "rotor.mass_kg 7",
    ):
        assert words in out
    _, out, _ = run_rig("log", path, "--no-verify")
    assert "finished, not verified" in out
    _, out, _ = run_rig("log", path, "--events")
    assert sum(line.startswith("event") for line in out.splitlines()) >= 2


def test_gaps_are_listed_with_number_and_span(run_rig: Any, tmp_path: Path) -> None:
    from daq.items import DeviceEvent

    with LogFile(tmp_path / "run.mcap", {}, {}, (), 10**18) as file:
        for second in range(3):
            gap = DeviceEvent("gap", "laser_x", f"{second} samples lost", {"samples": second, "span_s": 0.5})
            file.event(gap, 10**18 + second * 10**9)
        path = file.finish({"losses": {"laser_x": {"samples": 3}}})
    _, out, _ = run_rig("log", path)
    assert "laser_x 3 samples" in out
    assert "gap 3 times, 1.5 s" in out
    assert "3 like it until 2.000 s" in out


def test_damage_is_exit_1_and_reported(run_rig: Any, tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1  # samples: opening the log does not read them
    path.write_bytes(data)
    code, out, _ = run_rig("log", path)
    assert code == 1
    assert "not whole" in out
    assert "missing" in out
    code, _, _ = run_rig("log", path, "--no-verify")
    assert code == 0


def test_a_cut_log_is_exit_1_and_shows_what_is_there(run_rig: Any, tmp_path: Path) -> None:
    path = make_log(tmp_path / "run.mcap", cut=True, rig="bench", note="evil\x1b[2J\nnote")
    code, out, _ = run_rig("log", path)
    assert code == 1
    assert "cut, or still being recorded, not whole" in out
    assert "\x1b" not in out
    assert "3 samples" in out


def test_content_that_is_not_its_schemas_is_reported_and_the_rest_shown(run_rig: Any, tmp_path: Path) -> None:
    from daq.channels import TACHO
    from daq.mcap.writer import BlockWriter

    path = tmp_path / "odd.mcap"
    with open(path, "wb") as file:
        writer = BlockWriter(file)
        writer.start()
        schema = writer.register_schema(TACHO.schema_name, "protobuf", TACHO.file_descriptor_set())
        writer.add_message(writer.register_channel("tacho", "protobuf", schema), 5, 5, 0, b"\x0d\x01")
        writer.add_message(writer.register_channel("events", "json", 0), 5, 5, 0, b"{no json")
        writer.add_message(writer.register_channel("health", "json", 0), 5, 5, 0, b"[1]")
        writer.add_attachment("rig.json", "application/json", b"[]", 5)
        writer.add_attachment("identities.json", "application/json", b"{", 5)
        writer.finish()
    code, out, _ = run_rig("log", path, "--json")
    found = json.loads(out)
    assert code == 1
    assert len(found["unreadable"]) == 5
    assert found["channels"] == {"tacho": None}
    code, out, _ = run_rig("log", path)
    assert out.count("unreadable") >= 5


ODD = [None, [], {}, "text", float("nan"), 10**400, -1, True]


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: repr(odd)[:9])
def test_hostile_content_is_shown_and_is_harmless(run_rig: Any, tmp_path: Path, odd: Any) -> None:
    from daq.mcap.writer import BlockWriter

    path, figure = tmp_path / "odd.mcap", tmp_path / "figure.svg"
    with open(path, "wb") as file:
        writer = BlockWriter(file)
        writer.start()
        names = ("kind", "device", "text", "state", "span_s", "losses", "disk", "stalled", "samples")
        for topic in ("events", "health"):
            channel = writer.register_channel(topic, "json", 0)
            for kind in ("gap", "lock", "fault", odd):
                note = {**dict.fromkeys(names, odd), "kind": kind, "disk": {"slow_s": odd}}
                writer.add_message(channel, 5, 5, 0, json.dumps(note).encode())
        writer.add_metadata("run", {"rig": "\x1b[2J", "started": "soon"})
        writer.add_metadata("summary", {"odd": json.dumps(odd)})
        for name in ("rig.json", "identities.json"):
            writer.add_attachment(name, "application/json", json.dumps({"rotor": odd, "name": odd}).encode(), 5)
        writer.finish()
    for options in ((), ("--events",), ("--json", "--events"), ("--plot", figure), ("--snapshot",)):
        code, out, _ = run_rig("log", path, *options)
        readable = isinstance(odd, dict) or "--snapshot" in options  # an identity is a table
        assert code == (0 if readable else 1)
        assert out or "--snapshot" in options
        assert "\x1b" not in out
    assert run_rig("logs", tmp_path)[0] == 0


def test_the_snapshot_is_a_rig_file(run_rig: Any, tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap")
    code, out, _ = run_rig("log", path, "--snapshot")
    rig = tmp_path / "as-it-was.toml"
    rig.write_text(out, encoding="utf-8")
    assert code == 0
    assert tomllib.loads(out)["rotor"]["mass_kg"] == 7
    assert load_rig(str(rig)).physics == load_rig("virtual").physics
    _, out, _ = run_rig("log", path, "--snapshot", "--json")
    assert json.loads(out)["rotor"]["mass_kg"] == 7


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_a_log_is_drawn(run_rig: Any, tmp_path: Path, suffix: str) -> None:
    path = write_small_log(tmp_path / "small.mcap")
    figure = tmp_path / f"figure.{suffix}"
    code, _, err = run_rig("log", path, "--plot", figure)
    assert code == 0
    assert figure.stat().st_size > 5000
    assert f"drawn: {figure}" in err


@pytest.mark.parametrize("keep", [200, 2000])
def test_a_log_cut_to_nothing_does_not_claim_that_nothing_was_lost(run_rig: Any, tmp_path: Path, keep: int) -> None:
    path = tmp_path / "cut.mcap.part"
    path.write_bytes(write_small_log(tmp_path / "small.mcap").read_bytes()[:keep])
    code, out, _ = run_rig("log", path)
    assert code == 1
    assert "unknown: it counts none" in out
    assert "nothing lost" not in out
    code, out, _ = run_rig("logs", tmp_path, "--json")
    (entry,) = [entry for entry in json.loads(out)["logs"] if entry["path"] == path.name]
    assert (entry["lost"], entry["losses_from"]) == (None, "")


# --- words -------------------------------------------------------------------------------------------------------


def test_quantities_for_people() -> None:
    lengths = [length(seconds) for seconds in (0.04, 89.94, 90, 5399, 5400, 86400)]
    assert lengths == ["0.0 s", "89.9 s", "1.50 min", "89.98 min", "1.50 h", "24.00 h"]
    assert [size(n) for n in (0, 999, 1000, 1_500_000, 10**13)] == ["0 B", "999 B", "1.0 kB", "1.5 MB", "10000.0 GB"]
    assert printable("a\x1b[2Jb\nc\u202e") == "a [2Jb c "
