"""Verdicts that cannot be written are one warning, with the names of their files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studies.validated_runs import keep_verdicts


@dataclass(frozen=True)
class _Point:
    source: str
    verdict: str = "pass"
    state: str = "I"
    why: str = ""


@dataclass(frozen=True)
class _Found:
    points: dict[str, _Point]
    start_ups: list[Any] = field(default_factory=list[Any])


@dataclass(frozen=True)
class _Run:
    source: str
    metadata: dict[str, str]


def test_five_points_in_a_folder_that_is_gone_give_one_warning(tmp_path: Path) -> None:
    logs = {name: str(tmp_path / "gone" / f"{name}.mcap") for name in "ABCDE"}
    found: Any = _Found({name: _Point(log) for name, log in logs.items()})
    runs: list[Any] = [_Run(log, {"digest": "sha256:" + 64 * "0"}) for log in logs.values()]
    (warning,) = keep_verdicts(found, runs, "p.toml")
    assert str(tmp_path / "gone") in warning
    assert all(f"{name}.mcap.verdict.json" in warning for name in logs)
