"""Predictions with a parameters file that contains run-out and a bow."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.prediction import predict_point
from rig_cli.main import run
from rig_configs import IdentifiedParameters, Rig, load_rig
from rig_configs.slow_roll import SlowRoll
from rig_configs.suspension_terms import TERMS, SuspensionTerms

RUN_OUT, BOW = 60e-6 * np.exp(0.8j), 100e-6 * np.exp(2.0j)


@pytest.fixture
def rig() -> Rig:
    return load_rig("virtual")


@pytest.fixture
def bent(rig: Rig) -> IdentifiedParameters:
    values = rig.physics.identified()
    roll = SlowRoll(complex(RUN_OUT), 0.5 * complex(RUN_OUT), complex(BOW), 1e-14 * np.eye(6), (0.5, 0.5))
    covariance = np.diag([(1e-4 * v) ** 2 for v in values.values()])
    return IdentifiedParameters(values, covariance, axis_angle_deg=(1.0, 0.05), slow_roll=roll)


def answer_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert run(list(arguments)) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("point", ["B", "D"])
def test_predict_with_a_bow_and_run_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, rig: Rig, bent: IdentifiedParameters, point: str
) -> None:
    bent.save(tmp_path / "p.toml")
    command = ("predict", "virtual", "--point", point, "--parameters", str(tmp_path / "p.toml"), "--no-release")
    found = json.loads(answer_of(capsys, *command, "--json"))
    state = found["steady_states"][0]
    near = np.radians([state["theta3_deg"], state["theta4_deg"]]).tolist()
    expected = predict_point(rig, bent, rig.physics.speed_rad_s(rig.points[point].speed_ratio), near_rad=near)
    assert np.degrees(expected.values[:2]) == pytest.approx([state["theta3_deg"], state["theta4_deg"]], abs=1e-3)
    sensors = state["sensors"]
    shown = [sensors[f"{name}_mm"] for name in ("amplitude_x", "amplitude_y", "amplitude")]
    assert shown == pytest.approx(1e3 * expected.values[2:], rel=1e-4)
    assert state["amplitude_mm"] == pytest.approx(1e3 * expected.state.amplitude_m, rel=1e-4)
    assert abs(sensors["amplitude_x_mm"] - sensors["of_motion_x_mm"]) > 1e-3
    assert found["slow_roll"]["bow"]["real_m"] == pytest.approx(BOW.real)
    text = answer_of(capsys, *command)
    assert "with run-out the sensors show x" in text
    assert "100 ± 0.1 µm at 114.6°, turning with the shaft" in text


def test_predict_of_a_straight_rotor_states_nothing_of_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, bent: IdentifiedParameters
) -> None:
    replace(bent, slow_roll=None).save(tmp_path / "p.toml")
    command = ("predict", "virtual", "--point", "B", "--parameters", str(tmp_path / "p.toml"), "--no-release")
    found = json.loads(answer_of(capsys, *command, "--json"))
    assert found["slow_roll"] is None
    assert "sensors" not in found["steady_states"][0]
    assert "run-out" not in answer_of(capsys, *command)


def test_the_region_is_that_of_imbalance_and_bow(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, bent: IdentifiedParameters
) -> None:
    """Twice the imbalance again is beyond both pendulums together."""
    roll = SlowRoll(0j, 0j, 6e-3 + 0j, np.zeros((6, 6)))
    replace(bent, slow_roll=roll).save(tmp_path / "p.toml")
    command = ("predict", "virtual", "--point", "C", "--parameters", str(tmp_path / "p.toml"), "--no-release", "--json")
    assert json.loads(answer_of(capsys, *command))["balancing_region"] == "undersized"


def test_budget_has_the_bow_and_the_map_leaves_it_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, bent: IdentifiedParameters
) -> None:
    bent.save(tmp_path / "p.toml")
    found = json.loads(
        answer_of(capsys, "parameters", "budget", str(tmp_path / "p.toml"), "B", "--rig", "virtual", "--json")
    )
    sources = [row["source"] for row in found["predicted"]["B.amplitude_x_mm"]["budget"]]
    assert any("bow" in source for source in sources)
    assert any("run-out of x" in source for source in sources)
    assert (
        run(
            [
                "map",
                "virtual",
                "--x",
                "speed_ratio=1:2:3",
                "--y",
                "stiffness_ratio=1:2:3",
                "--parameters",
                str(tmp_path / "p.toml"),
                "--json",
            ]
        )
        == 0
    )
    assert "leaves the bow out" in capsys.readouterr().err


def test_predict_with_a_suspension_that_depends_on_the_motion(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, rig: Rig
) -> None:
    """The damper's kinks leave multipliers good to 1e-7: without --accuracy no state is missing."""
    values = rig.physics.identified()
    terms = SuspensionTerms(np.array([1600.0, 1600.0, 1.0, 0.3]), np.diag([1e2, 1e2, 1e-4, 1e-4]), TERMS)
    known = IdentifiedParameters(values, np.diag([(1e-4 * v) ** 2 for v in values.values()]), terms=terms)
    known.save(tmp_path / "p.toml")
    command = ("predict", "virtual", "--point", "D", "--parameters", str(tmp_path / "p.toml"), "--no-release", "--json")
    state = json.loads(answer_of(capsys, *command))["steady_states"][0]
    expected = predict_point(rig, known, rig.physics.speed_rad_s(3.3), (0.0, 0.0)).state
    assert (state["type"], state["stable"]) == ("III", True)
    assert state["theta3_deg"] == pytest.approx(np.degrees(expected.theta_rad[0]), abs=1e-3)
    assert run([*command, "--accuracy", "1e-8"]) == 0
    assert "III" not in [s["type"] for s in json.loads(capsys.readouterr().out)["steady_states"]]
