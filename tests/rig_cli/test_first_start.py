"""The usual commands are compiled once after an installation, and one process does it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rig_cli import first_start


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Command lines of the processes that would be started."""
    lines: list[list[str]] = []

    def note(line: list[str], **_: Any) -> SimpleNamespace:
        lines.append(line)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(subprocess, "Popen", note)
    monkeypatch.setattr(subprocess, "run", note)
    return lines


def test_the_first_command_starts_the_compilation_and_later_ones_do_not(
    started: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "compiled-0123456789abcdef"
    assert first_start.compile_in_background(place)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(place))
    monkeypatch.setattr(sys, "argv", ["first_start"])
    assert first_start.main() == 0
    assert not first_start.compile_in_background(place)
    assert [line[:3] for line in started] == [
        [sys.executable, "-m", "rig_cli.first_start"],
        [sys.executable, "-m", "rig_cli.entry"],
        [sys.executable, "-m", "rig_cli.entry"],
    ]


def test_a_directory_compiled_before_is_not_compiled_again(
    started: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["first_start"])
    assert [first_start.main(), first_start.main()] == [0, 0]
    assert [line[3] for line in started] == ["predict", "demo"]


@pytest.mark.parametrize("name", [None, "pendulum-balancer-rig-x1y2"])
def test_a_users_own_directory_and_a_temporary_one_are_left_alone(
    started: list[list[str]], tmp_path: Path, name: str | None
) -> None:
    assert not first_start.compile_in_background(tmp_path / name if name else None)
    assert started == []
