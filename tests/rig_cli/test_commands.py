"""The command: exit codes, JSON contract, messages."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rig_cli.main import run
from tests.daq.small_log import write_small_log


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_predict_gives_the_contract_keys_and_the_expected_states(capsys: pytest.CaptureFixture[str]) -> None:
    for point, kind in (("A", "III"), ("B", "I")):
        code, out, _ = run_rig(capsys, "predict", "virtual", "--point", point, "--json")
        result = json.loads(out)
        assert code == 0
        assert set(result) >= {"model", "why", "speed_ratio", "speed_rpm", "steady_states", "release"}
        first = result["steady_states"][0]
        assert set(first) >= {
            "type",
            "theta3_deg",
            "theta4_deg",
            "amplitude_mm",
            "stable",
            "multiplier_max",
            "error_estimate",
        }
        assert (first["type"], first["stable"]) == (kind, True)
        assert result["release"]["reaches"] == kind


def test_predict_states_which_model_and_why(capsys: pytest.CaptureFixture[str]) -> None:
    for rig, words in (("virtual", "k1 ≠ k2"), ("isotropic", "isotropic suspension")):
        code, out, _ = run_rig(capsys, "predict", rig, "--speed-ratio", "1.6")
        assert code == 0
        assert f"why: {words}" in out or words in out.splitlines()[1]
    code, out, _ = run_rig(capsys, "predict", "virtual", "--point", "B", "--set", "suspension.gravity_m_per_s2=9.81")
    assert "gravity" in out.splitlines()[1]


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_predict_draws(capsys: pytest.CaptureFixture[str], tmp_path: Path, suffix: str) -> None:
    figure = tmp_path / f"b.{suffix}"
    assert run_rig(capsys, "predict", "virtual", "--point", "B", "--plot", str(figure))[0] == 0
    assert figure.stat().st_size > 5000
    code, _, err = run_rig(capsys, "predict", "virtual", "--point", "B", "--plot", str(tmp_path / "b.doc"))
    assert code == 2
    assert ".svg, .png or .pdf" in err


def test_map_writes_arrays_and_figure(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arrays, figure = tmp_path / "map.npz", tmp_path / "map.png"
    code, out, _ = run_rig(
        capsys,
        "map",
        "virtual",
        "--x",
        "speed_ratio=0.5:6:23",
        "--y",
        "stiffness_ratio=1:15:8",
        "--plot",
        str(figure),
        "-o",
        str(arrays),
        "--json",
    )
    result = json.loads(out)
    assert (code, result["points"]) == (0, 184)
    with np.load(arrays) as found:
        numbers = {"speed_ratio", "stiffness_ratio", "multiplier_max", "error_estimate", "decay_rate_per_s"}
        assert set(found) == numbers | {"provenance"}
        assert found["multiplier_max"].shape == found["error_estimate"].shape == (8, 23)
        assert np.all(found["error_estimate"] <= 1e-8 * np.maximum(1, found["multiplier_max"]))
    assert figure.stat().st_size > 5000


def test_set_changes_the_prediction(capsys: pytest.CaptureFixture[str]) -> None:
    _, before, _ = run_rig(capsys, "predict", "virtual", "--point", "D", "--json")
    _, after, _ = run_rig(capsys, "predict", "virtual", "--point", "D", "--json", "--set", "suspension.k2_N_per_m=+5%")
    amplitude = [json.loads(x)["steady_states"][0]["amplitude_mm"] for x in (before, after)]
    assert amplitude[1] < 0.95 * amplitude[0]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["predict", "virtual", "--point", "Z"], 2, "no point 'Z'"),
        (["predict", "virtual"], 2, "give one of --point"),
        (["map", "virtual", "--x", "speed_ratio=1:2", "--y", "stiffness_ratio=1:15:8"], 2, "expected KEY=A:B:N"),
        (["map", "virtual", "--x", "speed_ratio=2:1:5", "--y", "stiffness_ratio=1:15:8"], 2, "0 < A < B"),
        (["predict", "virtual", "--point", "A", "--set", "rotor.mass=3"], 2, "did you mean rotor.mass_kg"),
        (["predict", "nosuch", "--point", "A"], 2, "no such rig file"),
        (["nosuchverb"], 2, "nosuchverb"),
        (["log", "nosuch.mcap"], 2, "nosuch.mcap"),
        (["identify"], 2, "no log given"),
        (["validate", "virtual", "x.mcap"], 2, "parameters.toml"),
        (["check", "virtual"], 3, "printed by `rig virtual`: cannot be opened"),
        (["demo", "--fault", "k2=1@nowhere"], 2, "expected KEY=VALUE@STEP"),
    ],
)
def test_bad_use_is_explained(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, words: str) -> None:
    found, out, err = run_rig(capsys, *arguments)
    assert found == code
    assert words in " ".join((out + err).split())


def test_a_check_without_an_open_device_does_not_observe_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "check", "virtual", "--json")
    assert code == 3
    assert json.loads(out)["seconds"] < 2.0, "10 s, and 3 s more for reports, if any device is open"


def test_log_and_replay_of_a_small_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap")
    code, out, _ = run_rig(capsys, "log", str(path), "--json")
    facts = json.loads(out)
    assert code == 0
    assert facts["complete"] is True
    assert facts["channels"]["laser/x"]["samples"] == 400
    code, out, _ = run_rig(capsys, "replay", str(path), "--check", "--json")
    assert code == 0
    assert json.loads(out)["identical"] is True


def test_replay_notices_a_changed_sample(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = write_small_log(tmp_path / "small.mcap", falsify=True)
    code, out, _ = run_rig(capsys, "replay", str(path), "--check")
    assert code == 1
    assert "differ in displacement_m" in out


@pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv to build a wheel")
def test_the_wheel_carries_the_rig_files_and_runs_outside_the_checkout(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    subprocess.run(["uv", "build", "--wheel", "--out-dir", str(tmp_path), str(root)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    target = tmp_path / "site"
    subprocess.run(
        ["uv", "pip", "install", "--python", sys.executable, "--no-deps", "--target", str(target), str(wheel)],
        check=True,
        capture_output=True,
    )
    script = (
        "import sys; from rig_cli.main import run; import rig_configs; print(rig_configs.__file__, file=sys.stderr); "
    )
    done = subprocess.run(
        [sys.executable, "-c", script + "sys.exit(run(['predict', 'isotropic', '--point', 'above', '--json']))"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(target), "PATH": "", "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert str(target) in done.stderr
    assert json.loads(done.stdout)["steady_states"][0]["type"] == "I"


def test_a_map_of_one_row_is_a_curve_and_bad_places_are_refused_first(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    figure = tmp_path / "row.svg"
    axes = ["--x", "speed_ratio=1:2:5", "--y"]
    assert run_rig(capsys, "map", "virtual", *axes, "stiffness_ratio=2:2:1", "--plot", str(figure))[0] == 0
    assert "largest |multiplier| at K = 2" in figure.read_text(encoding="utf-8")
    for option, word in (
        (["-o", str(tmp_path / "a.csv")], ".npz"),
        (["--plot", str(tmp_path / "no" / "a.svg")], "does not exist"),
    ):
        code, _, err = run_rig(capsys, "map", "virtual", *axes, "stiffness_ratio=2:3:2", *option)
        assert code == 2
        assert word in err
    code, _, err = run_rig(
        capsys, "map", "virtual", "--x", "speed_ratio=1:2:100000", "--y", "stiffness_ratio=1:2:100000"
    )
    assert code == 2
    assert "at most" in err


def test_every_command_has_its_line_in_the_overview(capsys: pytest.CaptureFixture[str]) -> None:
    from rig_cli.main import commands

    assert run(["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    listed, loaded = commands(), commands({name for name in commands() if not name.startswith("-")})
    for name in listed:
        if not name.startswith("-"):
            line = listed[name].help
            assert line == loaded[name].help.partition("\n")[0], (
                f"{name}: its line differs from the summary of the command"
            )
            assert line in shown
    assert run(["export", "--help"]) == 0
    assert "several channels become" in capsys.readouterr().out  # the whole text, not only the line
