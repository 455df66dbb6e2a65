"""`rig validate`: what-ifs change the output and no stored verdict; z can be computed from its row."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from rig_cli.main import run
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, load_rig
from tests.rig_cli.test_exchange import BALANCED_COLUMNS, balanced_point

RIG = load_rig("virtual")


def known(path: Path, axis_angle_deg: tuple[float, float] | None = (1.0, 0.01)) -> Path:
    values = {name: RIG.physics.identified()[name] for name in PARAMETER_UNITS}
    std = np.array([1e-3 * abs(value) for value in values.values()])
    IdentifiedParameters(values, np.diag(std**2), {"tests": []}, axis_angle_deg).save(path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("point")
    out = folder / "b.mcap"
    table = balanced_point(folder / "b.csv")
    assert run(["import", str(table), "--rig", "virtual", "--point", "B", "-o", str(out), *BALANCED_COLUMNS]) == 0
    return out


def validated(capsys: pytest.CaptureFixture[str], log: Path, toml: Path, *more: object) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = run(["validate", "virtual", str(log), "--parameters", str(toml), "--json", *map(str, more)])
    captured = capsys.readouterr()
    assert captured.out, captured.err
    return code, json.loads(captured.out)


def test_a_what_if_lies_over_the_parameters_and_keeps_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    toml, verdict = known(tmp_path / "p.toml"), log.with_name(log.name + ".verdict.json")
    code, plain = validated(capsys, log, toml)
    assert (code, plain["passed"], plain["what_if"]) == (0, True, [])
    official = verdict.read_bytes()
    report = tmp_path / "what-if.html"
    setting = "imbalance.radius_m=+5%"
    code, changed = validated(capsys, log, toml, "--set", setting, "--report", report)
    assert (code, changed["passed"], changed["what_if"]) == (1, False, [setting])
    moved = changed["points"]["B"]["predicted"]["theta3_deg"] - plain["points"]["B"]["predicted"]["theta3_deg"]
    moment, pendulum = RIG.physics.imbalance_moment_kg_m, RIG.physics.a.first_moment_kg_m
    rest = [math.degrees(math.acos(-share * moment / (2 * pendulum))) for share in (1.0, 1.05)]
    side = 1 if plain["points"]["B"]["predicted"]["theta3_deg"] < 180 else -1  # of two mirror images
    assert moved == pytest.approx(side * (rest[1] - rest[0]), abs=1e-4)
    # what is set is taken as exact: S_P's own uncertainty has gone from the prediction
    assert (
        changed["points"]["B"]["predicted_std"]["theta3_deg"]
        < 0.1 * plain["points"]["B"]["predicted_std"]["theta3_deg"]
    )
    assert verdict.read_bytes() == official
    page = report.read_text(encoding="utf-8")
    assert "<title>What if: validation of virtual</title>" in page
    assert "imbalance.radius_m=+5%" in page
    assert "Uncertainty budgets" in page
    assert "<b>B.theta3_deg</b>" in page
    slight = "imbalance.radius_m=+0.001%"  # passes: no causes are sought, which takes most of the time
    assert run(["validate", "virtual", str(log), "--parameters", str(toml), "--set", slight]) == 0
    assert f"what if {slight}" in capsys.readouterr().out
    assert verdict.read_bytes() == official


def test_z_follows_from_its_row(capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path) -> None:
    _, found = validated(capsys, log, known(tmp_path / "p.toml"))
    scores = found["points"]["B"]["scores"]
    assert set(scores) == {"theta3", "theta4", "amplitude_x", "amplitude_y", "amplitude"}
    for name, row in scores.items():
        if row["statistic"] == "difference":
            apart = (row["measured_deg"] - row["predicted_deg"] + 180) % 360 - 180
            z = apart / math.hypot(row["measured_std_deg"], row["predicted_std_deg"])
        else:
            assert name.startswith("amplitude")
            assert row["p"] == pytest.approx(chi2.sf(row["chi2"], row["dof"]), rel=1e-9)
            z = norm.isf(row["p"] / 2)
            if row["dof"] == 2:
                assert row["chi2"] == pytest.approx((row["measured_mm"] / row["noise_mm"][0]) ** 2)
        assert row["z"] == pytest.approx(z, rel=1e-6, abs=1e-9)
        assert found["points"]["B"]["z_scores"][name] == row["z"]


def test_the_axis_angle_is_the_identified_one_and_otherwise_reported(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    _, with_angle = validated(capsys, log, known(tmp_path / "p.toml"))
    assert not [w for w in with_angle["warnings"] if "sensor and stiffness axes" in w]
    older = known(tmp_path / "older.toml", axis_angle_deg=None)
    _, without = validated(capsys, log, older)
    assert [w for w in without["warnings"] if "0 ± 1° is assumed" in w]
    _, given = validated(capsys, log, older, "--axis-angle-deg", 1.0, "--axis-angle-std-deg", 0.01)
    assert not [w for w in given["warnings"] if "axes" in w]
    assert given["what_if"] == []
    _, other = validated(capsys, log, tmp_path / "p.toml", "--axis-angle-deg", 4.0, "--axis-angle-std-deg", 0.1)
    assert other["what_if"] == ["axis angle 4 ± 0.1°"]
    assert run(["validate", "virtual", str(log), "--parameters", str(older), "--axis-angle-deg", "1"]) == 2


def test_predict_marks_a_what_if(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    toml = known(tmp_path / "p.toml")
    command = ["predict", "virtual", "--point", "D", "--parameters", str(toml), "--no-release"]
    assert run([*command, "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert run([*command, "--json", "--set", "suspension.k2_N_per_m=+5%"]) == 0
    changed = json.loads(capsys.readouterr().out)
    assert (plain["what_if"], changed["what_if"]) == ([], ["suspension.k2_N_per_m=+5%"])
    assert plain["steady_states"][0]["amplitude_mm"] != changed["steady_states"][0]["amplitude_mm"]
    assert run([*command, "--set", "suspension.k2_N_per_m=+5%"]) == 0
    assert "what if suspension.k2_N_per_m=+5%" in capsys.readouterr().out
