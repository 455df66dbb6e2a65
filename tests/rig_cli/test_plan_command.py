"""rig plan: what to record, what cannot be reached, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig_cli.main import run
from rig_configs import IdentifiedParameters


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_plan_states_what_how_long_and_how_large(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "plan", "virtual", "--want", "zeta1=1%", "--want", "c3=2%")
    assert code == 0
    assert "ring-down-x" in out
    assert "pluck by" in out
    assert "flick both to" in out
    assert "✓ zeta1" in out
    code, out, _ = run_rig(capsys, "plan", "virtual", "--want", "zeta1=1%", "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["possible"] is True
    (step,) = answer["steps"]
    assert step["test"] == "ring-down-x"
    assert step["settings"].keys() == {"pluck_mm", "record_s"}
    assert answer["wants"]["zeta1"]["reached_relative_std"] <= 0.01


def test_what_cannot_be_reached_is_reported_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "plan", "virtual", "--want", "k1=0.01%", "--mass-std", "0.05%")
    assert code == 1
    assert "k1 to 0.01 % cannot be reached with these sensors: mass limits it to 0.05 %" in out
    code, out, _ = run_rig(capsys, "plan", "virtual", "--want", "SP=0.01%", "--json")
    assert code == 1
    assert json.loads(out)["wants"]["SP_kg_m"]["limited_by"] == "gain"


def test_identified_parameters_are_the_prior_estimates(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    IdentifiedParameters({"zeta1": 0.1}, np.array([[1e-8]])).save(tmp_path / "p.toml")
    _, out, _ = run_rig(
        capsys, "plan", "virtual", "--want", "zeta1=0.001", "--parameters", str(tmp_path / "p.toml"), "--json"
    )
    answer = json.loads(out)["wants"]["zeta1"]
    assert answer["believed"] == 0.1
    assert answer["wanted_relative_std"] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["virtual"], "give what is to be identified"),
        (["virtual", "--want", "zetta1=1%"], "did you mean zeta1"),
        (["virtual", "--want", "k1=5"], "in N/m"),
        (["virtual", "--want", "k1=1%", "--mass-std", "150%"], "expected a share"),
        (["virtual", "--want", "k1=1%", "--want", "k1=2%"], "once"),
        (["virtual", "--want", "k1=1%", "--log", "nothing.mcap"], "nothing.mcap"),
        (["nosuch", "--want", "k1=1%"], "no such rig file"),
    ],
)
def test_bad_use_is_explained(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    code, out, err = run_rig(capsys, "plan", *arguments)
    assert code == 2
    assert words in " ".join((out + err).split())
