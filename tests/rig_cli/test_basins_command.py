"""`rig basins`: files, figure, probabilities; what it refuses and why."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig_cli.main import run
from rig_configs import IdentifiedParameters


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(["basins", "virtual", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_map_with_its_files_and_probabilities(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arrays, figure, parameters = tmp_path / "basins.npz", tmp_path / "basins.svg", tmp_path / "parameters.toml"
    IdentifiedParameters({"zeta1": 0.021}, np.array([[1e-10]])).save(parameters)
    code, out, _ = run_rig(
        capsys,
        "--point",
        "E",
        "--grid",
        "6x4",
        "--seconds",
        "10",
        "--probabilities",
        "5",
        "--parameters",
        str(parameters),
        "-o",
        str(arrays),
        "--plot",
        str(figure),
        "--json",
    )
    result = json.loads(out)
    assert code == 0
    assert result["releases"] == 24
    assert [end["type"] for end in result["ends"]] == ["I", "I"]
    assert [end["mirror_image"] for end in result["ends"]] == [0, 1]
    assert sum(end["share"] for end in result["ends"]) + result["not_settled_share"] == pytest.approx(1.0)
    assert sum(end["count"] for end in result["probabilities"]["ends"]) == 5
    with np.load(arrays) as found:
        assert found["end"].shape == (4, 6)
        assert found["theta3_deg"] == pytest.approx(np.arange(6) * 60 - 150)
        assert found["theta4_deg"] == pytest.approx(np.arange(4) * 90 + 45)
        shares = [float(np.mean(found["end"] == i)) for i in range(2)]
        assert np.all(found["settled_s"][found["end"] >= 0] > 0)
    assert shares == pytest.approx([end["share"] for end in result["ends"]])
    text = figure.read_text("utf-8")
    for words in ("where a release ends", "I: A at 108.3°, B at 251.7°", "release of the real locks", "Ω = 5.8"):
        assert words in text


def test_slipping_is_reported_with_its_rates(capsys: pytest.CaptureFixture[str]) -> None:
    strong = ("--set", "suspension.zeta1=0.05", "--set", "suspension.zeta2=0.05")
    code, out, _ = run_rig(capsys, "--point", "D", "--grid", "2x2", *strong)
    assert code == 0
    assert "100.0 %  slipping, A -0.046273 and B -0.046273 turns per revolution" in out
    assert "what if suspension.zeta1=0.05" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--grid", "6x4"), "give one of --point, --speed-rpm, --speed-ratio"),
        (("--point", "Q"), "no point 'Q'"),
        (("--point", "E", "--grid", "6"), "expected N3xN4"),
        (("--point", "E", "--grid", "0x5"), "expected N3xN4"),
        (("--point", "E", "-o", "basins.csv"), "a name ending in .npz"),
        (("--point", "E", "--probabilities", "0"), "expected 1 to"),
        (("--point", "E", "--grid", "1x1", "--set", "pendulums.a.friction_arm_m=1e-5"), "friction"),
    ],
)
def test_what_is_refused(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str) -> None:
    code, _, error = run_rig(capsys, *arguments)
    assert code == 2
    assert words in error
