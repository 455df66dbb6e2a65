"""What stands in place of a file, and what stands in one: refused in words, and shown as text."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import pytest
from rich.console import Console

from daq.log.file import LogFile
from rig_cli import console
from rig_cli.console import StepProgress, harmless, notify
from rig_cli.main import run
from rig_cli.share_progress import share_progress
from tests.daq.small_log import write_small_log

COMMANDS = (
    ("log", "{}"),
    ("recover", "{}"),
    ("replay", "{}"),
    ("replay", "{log}", "-o", "{out}", "--calibration", "{}"),
    ("export", "{}", "-o", "{out}.csv"),
    ("import", "{}", "-o", "{out}", "--rig", "virtual", "--x", "1:m", "--test", "ring-down-x", "--rate", "100"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hostile")
    write_small_log(path / "good.mcap")
    (path / "folder.mcap").mkdir()
    (path / "loop.mcap").symlink_to("loop.mcap")
    if hasattr(os, "mkfifo"):
        os.mkfifo(path / "pipe.mcap")
    return path


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
@pytest.mark.parametrize("name", ["pipe.mcap", "folder.mcap", "loop.mcap", "/dev/zero", "gone.mcap"])
def test_what_is_no_file_is_refused_without_waiting_for_it(
    folder: Path, tmp_path: Path, command: tuple[str, ...], name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    names = {"log": folder / "good.mcap", "out": tmp_path / "out.mcap"}
    assert run([part.format(folder / name, **names) for part in command]) == 2
    text = capfd.readouterr().err
    assert text.startswith("rig: ")
    assert "Traceback" not in text
    assert name in text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_list_of_logs_mentions_what_is_not_a_log(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(folder / "good.mcap.verdict.json")
    try:
        assert run(["logs", str(folder), "--json"]) == 0
        entries = {entry["path"]: entry for entry in json.loads(capfd.readouterr().out)["logs"]}
        assert entries["pipe.mcap"]["state"] == "unreadable"
        assert (entries["good.mcap"]["state"], entries["good.mcap"]["verdict"]) == ("finished", "unreadable")
        assert run(["log", str(folder / "good.mcap"), "--json"]) == 1
        assert "named pipe" in json.loads(capfd.readouterr().out)["unreadable"][0]
    finally:
        (folder / "good.mcap.verdict.json").unlink()


def test_a_recovery_that_kept_no_message_is_a_failure(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    log = LogFile(path, {"rig": "x"}, {"rig.json": b"{}"}, ("laser_x",), 10**18)
    log.flush()
    log.close()
    assert run(["recover", str(log.part), "--json"]) == 1
    found = json.loads(capfd.readouterr().out)
    assert (found["recovered"], found["messages"]) == ("nothing", 0)
    assert run(["recover", str(log.part), "-o", str(tmp_path / "again.mcap")]) == 1
    assert "no message was left" in capfd.readouterr().err


HOSTILE = "[/red] [bold]x[/] :smile: \x1b[2J\x1b]0;title\x07 \r\u202eover\x9b31m"


def test_text_of_any_origin_is_shown_as_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = io.StringIO()
    terminal = console._Stderr()
    terminal.file = shown
    monkeypatch.setattr(console, "STDERR", terminal)
    terminal.print(f"laser_x  name {HOSTILE}")
    with StepProgress({HOSTILE: 1.0}) as progress:
        progress.step(HOSTILE)
        progress.update(HOSTILE)
        progress.notify(HOSTILE)
    with share_progress(HOSTILE) as answer:
        answer(0.5)
    notify(HOSTILE)
    for text in (shown.getvalue(), capsys.readouterr().err):
        assert "[/red] [bold]x[/] :smile:" in text
        assert not set("\x1b\x07\r\u202e\x9b") & set(text)


def test_a_progress_bar_takes_any_name() -> None:
    drawn = io.StringIO()
    terminal = console._Stderr()
    bar = console.Progress(
        console.TextColumn("{task.description}", markup=False),
        console=Console(file=drawn, force_terminal=True, markup=False),
    )
    with bar:
        bar.add_task(harmless(HOSTILE), total=1.0)
    assert "[/red]" in drawn.getvalue()
    assert terminal._markup is False


def test_lines_and_letters_of_every_language_stay() -> None:
    assert harmless("θ3 = 5°,\n\tμ… 日本\u202f1") == "θ3 = 5°,\n\tμ… 日本\u202f1"
    assert harmless("\ud800\u2028") == "\ufffd\ufffd"
