"""An unexpected error: an exit code, one line, a file with what to send; no secrets, no second error."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from rig_cli import crash, main, signals
from rig_cli.console import print_json


def interrupted() -> None:
    raise KeyboardInterrupt("SIGTERM")


def fails(*_: object, **__: object) -> None:
    raise ZeroDivisionError("float division by zero")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.chdir(tmp_path)
    return folder


def test_an_unforeseen_error_has_its_own_code_and_a_report(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    monkeypatch.setattr("rig_cli.model.load_rig", fails)
    arguments = ["predict", "https://me:hunter2@host/rig?token=abc123", "--set", "x" * 9999]
    assert main.run(arguments) == 70
    err = capsys.readouterr().err
    (report,) = temporary.iterdir()
    assert len(err.splitlines()) == 1
    assert str(report) in err
    assert "ZeroDivisionError: float division by zero" in err
    text = report.read_text()
    for words in ("predict", "Traceback", "in fails", "numpy", "python"):
        assert words in text
    assert "hunter2" not in text
    assert "abc123" not in text
    assert len(text) < 9999
    if os.name == "posix":
        assert report.stat().st_mode & 0o077 == 0


def test_an_error_after_a_dropped_interruption_is_an_interruption(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    """A callback of the compiler drops the interruption, and the compilation then fails in another way."""
    monkeypatch.setattr(main, "dropped", [])
    monkeypatch.setattr(signals, "dropped", main.dropped)
    monkeypatch.setattr(signals, "send_again", lambda number: None)
    monkeypatch.setattr(sys, "unraisablehook", signals.note_dropped)
    call = ctypes.CFUNCTYPE(None)(interrupted)
    monkeypatch.setattr("rig_cli.model.load_rig", lambda *_, **__: (call(), fails()))
    assert main.run(["predict", "virtual"]) == 130
    assert capsys.readouterr().err == "rig: interrupted by SIGTERM\n"
    assert not list(temporary.iterdir())


def test_what_an_interruption_left_half_made_prints_no_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A compiler's object that is deleted before it was made whole: its `__del__` fails after the interruption."""

    class HalfMade:
        def __init__(self) -> None:
            interrupted()
            self.whole = True

        def __del__(self) -> None:
            del self.whole

    monkeypatch.setattr(sys, "unraisablehook", signals.note_dropped)
    monkeypatch.setattr("rig_cli.model.load_rig", lambda *_, **__: HalfMade())
    assert main.run(["predict", "virtual"]) == 130
    assert capsys.readouterr().err == "rig: interrupted by SIGTERM\n"


def test_where_nothing_can_be_written_the_report_goes_to_the_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    monkeypatch.setattr(tempfile, "mkstemp", fails)
    assert crash.report(ValueError("odd"), ["check"]) == 70
    assert "Traceback" in (err := capsys.readouterr().err) or "ValueError: odd" in err
    assert not list(temporary.iterdir())


def test_an_error_without_words_of_its_own_is_reported_too(capsys: pytest.CaptureFixture[str], temporary: Path) -> None:
    class Mute(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no words")

    assert crash.report(Mute(), []) == 70
    assert "Mute" in capsys.readouterr().err


def test_a_worker_s_traceback_is_in_the_report(capsys: pytest.CaptureFixture[str], temporary: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        error = pool.submit(fails).exception()
    assert error is not None
    crash.report(error, ["demo"])
    (report,) = temporary.iterdir()
    assert "in fails" in report.read_text()


def test_a_thread_that_dies_is_reported_and_changes_the_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    crash.watch_threads(["check", "virtual"])

    def starts_a_thread(_: object) -> int:
        thread = threading.Thread(target=fails, name="heartbeat")
        thread.start()
        thread.join()
        return 0

    monkeypatch.setattr(main, "_carried_out", starts_a_thread)
    assert main.run([]) == 70
    (report,) = temporary.iterdir()
    assert "heartbeat" in report.read_text()
    assert str(report) in capsys.readouterr().err


def test_an_unforeseen_error_is_one_json_object_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    monkeypatch.setattr("rig_cli.model.load_rig", fails)
    assert main.run(["predict", "virtual?token=abc123", "--json"]) == 70
    answer = json.loads(capsys.readouterr().out)
    (report,) = temporary.iterdir()
    assert answer["exit_code"] == 70
    assert "ZeroDivisionError: float division by zero" in answer["error"]
    assert str(report) in answer["error"]
    monkeypatch.setattr(crash, "_page", fails)
    assert main.run(["predict", "virtual", "--json"]) == 70
    assert json.loads(capsys.readouterr().out) == {"error": "unexpected error: ZeroDivisionError", "exit_code": 70}


@pytest.mark.parametrize("when", ["before the result", "after the result", "without a result"])
def test_a_thread_that_dies_leaves_one_json_object(
    when: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, temporary: Path
) -> None:
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    crash.watch_threads(["check", "virtual", "--json"])

    def starts_a_thread(_: object) -> int:
        if when == "after the result":
            print_json({"verdict": "fail"})
        thread = threading.Thread(target=fails, name="heartbeat")
        thread.start()
        thread.join()
        if when == "before the result":
            print_json({"verdict": "fail"})
        return 0 if when == "without a result" else 1

    monkeypatch.setattr(main, "_carried_out", starts_a_thread)
    code = main.run(["--json"])
    answer = json.loads(capsys.readouterr().out)
    if when == "after the result":
        assert (code, answer) == (1, {"verdict": "fail"})
    else:
        assert code == answer["exit_code"] == 70
        assert "ZeroDivisionError" in answer["error"]


def test_the_command_itself_exits_70(tmp_path: Path) -> None:
    broken = tmp_path / "cli_broken.py"
    broken.write_text(
        "import sys\nimport rig_cli.model\nrig_cli.model.check_outputs = 1\nfrom rig_cli.entry import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, str(broken), "predict", "virtual", "--json"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert done.returncode == 70
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["exit_code"] == 70
    assert len(list(tmp_path.glob("rig-error-*"))) == 1
