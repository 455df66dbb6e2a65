"""rig predict --sweep: break points, JSON, the figure, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.main import run

_SWEEP = [
    "predict",
    "isotropic",
    "--sweep",
    "imbalance.radius_m=0.005:0.1:20",
    "--speed-ratio",
    "2.5",
    "--set",
    "pendulums.b.mass_kg=0.037",
]


def test_break_points_and_figure(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run([*_SWEEP, "--json", "--plot", str(tmp_path / "s.svg")]) == 0
    result = json.loads(capsys.readouterr().out)
    values = [one["value"] * 0.12 for one in result["break_points"]]
    assert values == pytest.approx([(0.075 - 0.037) * 0.054, (0.075 + 0.037) * 0.054], rel=3e-6)
    assert {b["type"] for b in result["branches"]} == {"I", "II", "III"}
    text = (tmp_path / "s.svg").read_text(encoding="utf-8")
    assert "pendulum angle, °" in text
    assert "distance of the imbalance weight" in text


def test_printed_as_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(_SWEEP) == 0
    text = capsys.readouterr().out
    assert "stable before II, after I\n" in text
    assert "what if pendulums.b.mass_kg=0.037" in text


def test_over_the_speed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["predict", "isotropic", "--sweep", "speed_ratio=0.6:2:8", "--json"]) == 0
    types = [(one["before"], one["after"]) for one in json.loads(capsys.readouterr().out)["break_points"]]
    assert types == [(["III"], []), ([], ["I"])]


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--sweep", "imbalance.radius_m=0:0.1", "--speed-ratio", "2"], "rig predict: --sweep expected KEY=A:B:N"),
        (["--sweep", "imbalance.radius_m=0:0.1:9"], "expected a constant speed"),
        (["--sweep", "speed_ratio=0.5:2:9", "--speed-ratio", "2"], "goes over the speed"),
        (["--sweep", "imbalance.radios_m=0:0.1:9", "--speed-ratio", "2"], "did you mean imbalance.radius_m"),
        (["--sweep", "suspension.zeta1=-1:1:9", "--speed-ratio", "2"], "zeta1"),
        (["--sweep", "suspension.zeta1=0.1:0.1:1", "--speed-ratio", "2"], "N of 2 or more"),
        (["--sweep", "speed_ratio=0.5:2:9", "--model", "floquet"], "not with --sweep"),
        (["--sweep", "imbalance.radius_m=0:0.1:9", "--point", "Z"], "no point 'Z'"),
    ],
)
def test_refused(capsys: pytest.CaptureFixture[str], more: list[str], text: str) -> None:
    assert run(["predict", "isotropic", *more]) == 2
    assert text in capsys.readouterr().err
