"""Commands that take logs use the rig of these logs, and refuse logs and rig files of different rigs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from rig_cli.main import run
from rig_configs import load_rig
from tests.rig_cli.test_validate import known

MASS_KG = 9.0
K1, ZETA1 = 2616.0, 0.0208


def made(folder: Path, name: str, rig: Sequence[str], test: str = "ring-down-x") -> Path:
    """A decay in closed form of an oscillator of the rig's mass, with noise."""
    mass = load_rig("virtual", settings=[word for word in rig if "=" in word]).physics.total_mass_kg
    t = np.arange(8 * 1000) / 1000
    w = np.sqrt(K1 / mass)
    wave = w * np.sqrt(1 - ZETA1**2)
    x = 2 * np.exp(-ZETA1 * w * t) * np.cos(wave * t) + 4e-3 * np.random.default_rng(2).normal(size=len(t))
    table, out = folder / f"{name}.csv", folder / f"{name}.mcap"
    np.savetxt(table, np.column_stack([t, x, 0 * t]), "%.9g", delimiter=",", header="t,x,a", comments="")
    columns = ["--time", "t:s", "--x", "x:mm", "--theta3", "a:deg", "--theta4", "a:deg", "--phase", "a:deg"]
    assert run(["import", str(table), "--rig", "virtual", *rig, "--test", test, "-o", str(out), *columns]) == 0
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rigs")


@pytest.fixture(scope="module")
def heavy(folder: Path) -> Path:
    return made(folder, "heavy", ["--set", f"rotor.mass_kg={MASS_KG}"])


@pytest.fixture(scope="module")
def light(folder: Path) -> Path:
    return made(folder, "light", [])


def test_identify_takes_the_mass_from_the_log(capsys: pytest.CaptureFixture[str], heavy: Path, tmp_path: Path) -> None:
    capsys.readouterr()
    assert run(["identify", str(heavy), "-o", str(tmp_path / "p.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]["k1_N_per_m"]
    assert found["std"] < 0.01 * K1
    assert abs(found["value"] - K1) < 5 * found["std"] + 1e-3 * K1


@pytest.mark.parametrize(
    "words",
    [
        ["identify", "{heavy}", "--rig", "virtual", "-o", "{out}.toml"],
        ["identify", "{heavy}", "{light}", "-o", "{out}.toml"],
        ["validate", "virtual", "{heavy}", "--parameters", "{known}"],
        ["report", "{heavy}", "{light}", "-o", "{out}.html"],
        ["report", "{heavy}", "--rig", "virtual", "-o", "{out}.html"],
        ["track", "{heavy}", "--rig", "virtual"],
        ["plot", "residuals", "{heavy}", "{light}", "-o", "{out}.svg"],
        ["plot", "map", "{heavy}", "{light}", "-o", "{out}.svg"],
        ["plot", "slip", "{heavy}", "{light}", "-o", "{out}.svg"],
        ["plot", "multipliers", "{heavy}", "{light}", "-o", "{out}.svg"],
    ],
    ids=lambda words: " ".join(words[:2]) + f" {len(words)}",
)
def test_logs_and_files_of_different_rigs_are_refused(
    capsys: pytest.CaptureFixture[str], heavy: Path, light: Path, tmp_path: Path, words: list[str]
) -> None:
    toml = known(tmp_path / "known.toml")
    capsys.readouterr()
    code = run([word.format(heavy=heavy, light=light, known=toml, out=tmp_path / "out") for word in words])
    text = capsys.readouterr().err
    assert code == 2
    assert "rotor.mass_kg: " in text
    assert "9.0 in heavy.mcap" in text
    assert not (tmp_path / "out.toml").exists()


def test_plan_measures_noise_only_in_logs_of_the_same_sensors(
    capsys: pytest.CaptureFixture[str], folder: Path, light: Path
) -> None:
    wide = made(folder, "wide", ["--set", "devices.laser_x.lever_ratio=0.8"])
    capsys.readouterr()
    assert run(["plan", "virtual", "--want", "zeta1=1%", "--log", str(wide)]) == 2
    assert "lever_ratio of laser/x: 1.0 in virtual, 0.8 in wide.mcap" in capsys.readouterr().err


def test_an_archive_is_identified_with_the_rig_of_each_campaign(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    made(tmp_path / "logs", "heavy", ["--set", f"rotor.mass_kg={MASS_KG}"])
    words = ["study", "archive", str(tmp_path / "logs"), "--scheduler", "local:1", "--json", "-o"]
    assert run([*words, str(tmp_path / "own")]) == 0
    (row,) = json.loads(capsys.readouterr().out.splitlines()[-1])["campaigns"]
    assert row["parameters"]["k1_N_per_m"]["value"] == pytest.approx(K1, rel=0.01)
    assert run([*words, str(tmp_path / "given"), "--rig", "virtual"]) == 0
    (row,) = json.loads(capsys.readouterr().out.splitlines()[-1])["campaigns"]
    assert "rotor.mass_kg" in row["error"]


def test_verdict_files_that_a_pattern_matches_are_passed_over(
    capsys: pytest.CaptureFixture[str], heavy: Path, tmp_path: Path
) -> None:
    verdict = heavy.with_name(heavy.name + ".verdict.json")
    verdict.write_text("{}", encoding="utf-8")
    try:
        assert run(["identify", str(heavy), str(verdict), "-o", str(tmp_path / "p.toml")]) == 0
        assert run(["plot", "time", str(heavy), str(verdict), "-o", str(tmp_path / "a.svg")]) == 0
    finally:
        verdict.unlink()
    assert "verdict.json" not in capsys.readouterr().err
