"""The log is silent until it is shown; `--log-level` shows it, also in child processes; ignored errors leave a line."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig_basics.ignoring import ignoring
from rig_basics.log_output import LEVELS, PACKAGES, VARIABLE, UnknownLevel, show_log, show_log_as_parent
from rig_cli.main import split_log_level

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv(VARIABLE, "")
    before = {name: (log.handlers, log.level, log.propagate) for name in PACKAGES if (log := logging.getLogger(name))}
    yield
    for name, (handlers, level, propagate) in before.items():
        log = logging.getLogger(name)
        log.handlers, log.level, log.propagate = handlers, level, propagate


def test_every_package_with_code_is_shown() -> None:
    found = {path.parent.name for path in ROOT.glob("*/py.typed")}
    assert set(PACKAGES) == found - {"rig_basics"}


def test_without_a_call_nothing_is_written() -> None:
    lines = "".join(f"logging.getLogger({name + '.x'!r}).error('hidden')\n" for name in PACKAGES)
    program = f"import logging, {', '.join(PACKAGES)}\n{lines}"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def run(program: str) -> str:
    """Run a program that has imported what it needs, and return what it wrote to standard error."""
    begin = "import logging, os, sys; from rig_basics.log_output import show_log\n"
    command = [sys.executable, "-c", begin + program]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == ""
    return done.stderr


def test_a_level_shows_lines_from_it_on() -> None:
    shown = run(
        "show_log('INFO')\nlogging.getLogger('daq.x').debug('too detailed')\nlogging.getLogger('daq.x').info('shown')\n"
    )
    assert "daq.x: shown" in shown
    assert "too detailed" not in shown


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe without a reader is made with os.pipe and dup2")
def test_a_held_terminal_delays_no_caller_and_no_end() -> None:
    """Standard error is a full pipe that is never read; the program logs a megabyte and ends."""
    held = (
        "ours, theirs = os.pipe(); standard = os.dup(2); os.dup2(theirs, 2)\n"
        "show_log('debug'); log = logging.getLogger('daq.x')\n"
        "for number in range(10_000): log.debug('%d %s', number, 'x' * 100)\n"
        "os.write(standard, b'all logged')\n"
    )
    assert run(held) == "all logged"


def test_a_child_process_shows_its_lines_too() -> None:
    program = (
        "import logging; from rig_basics.log_output import show_log_as_parent; show_log_as_parent();"
        "logging.getLogger('live.y').warning('from the child')"
    )
    show_log("warning")
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "live.y: from the child" in child.stderr


def test_a_child_process_without_level_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    before = logging.getLogger("daq").handlers
    show_log_as_parent()
    assert logging.getLogger("daq").handlers == before


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(UnknownLevel, match="'loud': expected one of debug"):
        show_log("loud")
    assert not os.environ[VARIABLE]


@pytest.mark.parametrize("words", [["--log-level", "debug", "log", "x"], ["log", "x", "--log-level=debug"]])
def test_the_option_is_taken_from_any_place(words: list[str]) -> None:
    assert split_log_level(words) == (["log", "x"], "debug")


def test_words_after_two_dashes_are_not_options() -> None:
    assert split_log_level(["log", "--", "--log-level", "x"]) == (["log", "--", "--log-level", "x"], None)


def test_a_missing_level_is_refused_by_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rig_cli.entry", "log", "--log-level"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert f"expected one of {', '.join(LEVELS)}" in done.stderr


def test_an_ignored_error_leaves_a_line(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG), ignoring(logging.getLogger("daq.z"), "closing the port", OSError, KeyError):
        raise FileNotFoundError("gone")
    assert caplog.messages == ["closing the port: ignored FileNotFoundError: gone"]


def test_another_error_is_not_ignored() -> None:
    with pytest.raises(ValueError, match="wrong"), ignoring(logging.getLogger("daq.z"), "reading", OSError):
        raise ValueError("wrong")
