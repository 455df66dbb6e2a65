"""`rig predict --start-ups`: numbers, lines, figure, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.main import run


def test_start_ups_of_balls_scatter_and_leave_vibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = tmp_path / "ends.png"
    command = ["predict", "ball_balancer", "--speed-rpm", "1500", "--no-release", "--start-ups", "4"]
    assert run([*command, "--plot", str(figure), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["start_ups"]
    assert figure.stat().st_size > 5000
    assert found["friction_arm_m"] == pytest.approx([1.52e-4] * 2)
    assert found["scatter_deg"] > 1
    assert 0.02 < found["amplitude_x_mm"]["mean"] < found["locked_amplitude_x_mm"]
    assert len(found["theta_deg"]) == 4
    assert run(command) == 0
    assert "4 start-ups from rest: places scatter by" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--start-ups", "1"], "expected 2 to 10000"),
        (["--start-ups", "3", "--set", "pendulums.b.mass_kg=0"], "expected two pendulums or balls"),
    ],
)
def test_refusals(more: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["predict", "isotropic", "--speed-rpm", "600", "--no-release", *more]) == 2
    assert words in capsys.readouterr().err
