"""`rig predict --balancing` and `--lost`: output, JSON, figures, rejected arguments."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.main import run


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_balancing_of_the_nominal_rig(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "plane.svg"
    code, out, _ = run_rig(capsys, "predict", "isotropic", "--balancing", "--plot", str(figure))
    assert code == 0
    assert "S_P 2.54 g m: pendulums properly oversized" in out
    assert "S_P may grow by 5.56 g m before the region changes" in out
    assert "S_P may shrink without limit" in out
    assert "θ3 108.278° θ4 251.722°" in out
    assert "this rig" in figure.read_text(encoding="utf-8")


def test_balancing_with_uncertainty_near_a_border(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ["--set", "pendulums.b.mass_kg=0.028", "--set", "pendulums.a.mass_std_kg=0.0005"]
    code, out, _ = run_rig(capsys, "predict", "isotropic", "--balancing", "--json", *settings)
    assert code == 0
    found = json.loads(out)
    assert found["balancing_region"] == "properly oversized"
    assert found["SP_may_shrink_kg_m"] == pytest.approx(2.4e-6, abs=1e-8)
    assert found["SP_may_shrink_std_kg_m"] == pytest.approx(0.0005 * 0.054)
    assert 0.5 < found["probability_of_region"] < 0.55
    assert found["gravity_ring"]["holds_axis"]
    assert len(found["balanced_deg"]) == 2


def test_improperly_oversized_has_no_pose(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "predict", "isotropic", "--balancing", "--set", "pendulums.b.mass_kg=0.019")
    assert code == 0
    assert "improperly oversized" in out
    assert "which is not in it" in out
    assert "no pose" in out


def test_lost_of_an_isotropic_rig_is_exact(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "lost.html"
    code, out, _ = run_rig(capsys, "predict", "isotropic", "--lost", "--plot", str(figure))
    assert code == 0
    assert "Type II  (S_T 0 g m): never lost" in out
    assert "lost at speed ratio 0.86 … 1.163 (154.8 … 209.3 rpm)" in out
    assert "exact: isotropic" in out
    assert "this rig" in figure.read_text(encoding="utf-8")


def test_lost_on_two_stiffnesses_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "predict", "virtual", "--lost", "--json")
    assert code == 0
    found = json.loads(out)
    assert not found["exact"]
    (two, three) = found["lost"]
    assert two["speed_ratio"] == []
    assert [len(three["speed_ratio"]), len(three["speed_rpm"])] == [3, 3]
    assert three["speed_ratio"][0] == pytest.approx([0.9418, 1.0631], abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--balancing", "--lost"], "give --balancing or --lost alone"),
        (["--lost", "--speed-ratio", "2"], "without a point or a speed"),
        (["--lost", "--set", "pendulums.pivot_shift_m=0.001"], "without pivot shift and bow"),
    ],
)
def test_refusals(arguments: list[str], wanted: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run_rig(capsys, "predict", "isotropic", *arguments)
    assert code != 0
    assert wanted in err
