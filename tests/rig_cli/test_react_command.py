"""`rig react`: output, figure, rejected arguments."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.main import run

CHANGE = ["react", "virtual", "--point", "E", "--change", "imbalance.radius_m=+20%"]


def test_it_states_when_it_is_balanced_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = tmp_path / "reaction.svg"
    assert run([*CHANGE, "--plot", str(plot), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["before"], result["reaches"]) == ("I", "I")
    assert 1.0 < result["reaction_s"] < 5.0
    assert result["peak_mm"] == pytest.approx(0.171, abs=0.002)
    assert "within 5 % after" in plot.read_text(encoding="utf-8")
    assert run(CHANGE) == 0
    assert "reaches I, 0.0000 mm: within 5 %" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["react", "virtual", "--point", "E"], "expected --change KEY=VALUE"),
        (CHANGE[:2] + CHANGE[4:], "give one of --point, --speed-rpm, --speed-ratio"),
        ([*CHANGE[:3], "Z", *CHANGE[4:]], "no point 'Z' in virtual; known: A, B, C, D, E"),
        ([*CHANGE[:5], "imbalance.radius=1"], "imbalance.radius"),
        ([*CHANGE, "--set", "suspension.zeta1=0.05", "--set", "suspension.zeta2=0.05", "--share", "2"], "share must"),
    ],
)
def test_refusals(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    assert words in capsys.readouterr().err
