"""rig parameters show, diff, history and budget: contract keys, words, exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig_cli.main import run
from rig_cli.parameters_page import rounded
from rig_configs import IdentifiedParameters

VALUES = {"k1_N_per_m": 2600.0, "k2_N_per_m": 38000.0, "zeta1": 0.02}
STD = {"k1_N_per_m": 0.5, "k2_N_per_m": 8.0, "zeta1": 2e-5}


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def kept(
    path: Path, factors: dict[str, float] | None = None, day: int = 1, rig: str = "bench", left_out: str = ""
) -> Path:
    """A parameters file of one test that keeps it."""
    values = {n: v * (factors or {}).get(n, 1.0) for n, v in VALUES.items()}
    covariance = np.diag([STD[n] ** 2 for n in values])
    covariance[0, 2] = covariance[2, 0] = 0.7 * STD["k1_N_per_m"] * STD["zeta1"]
    clock = {"k1_N_per_m": 0.3, "k2_N_per_m": 0.0, "zeta1": 0.0}
    test = {
        "test": "ring-down",
        "log": f"{path.stem}.mcap",
        "digest": f"d{day}",
        "method": "made up",
        "values": values,
        "covariance": covariance.tolist(),
        "shared": {"clock laser_x": clock},
        "model_share": 0.25,
        "recorded": f"2026-03-{day:02d}T10:00:00+00:00",
    }
    if left_out:
        test["left_out"] = left_out
    total = covariance + np.outer(list(clock.values()), list(clock.values()))
    facts = {"software": "1.0", "method": "joint", "rig": rig, "tests": [test]}
    IdentifiedParameters(values, total, facts).save(path)
    return path


def test_show_shows_values_limits_and_correlations(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = kept(tmp_path / "p.toml")
    code, out, _ = run_rig(capsys, "parameters", "show", str(path))
    assert code == 0
    assert "2600.00" in out
    assert "noise 55 %, clock 26 %, model 18 %" in out
    assert "from" in out
    assert "ring-down" in out
    assert "correlated   zeta1 and k1 +0.60" in out
    code, out, _ = run_rig(capsys, "parameters", "show", str(path), "--json")
    (facts,) = json.loads(out)["files"]
    k1 = facts["parameters"]["k1_N_per_m"]
    assert k1["unit"] == "N/m"
    assert k1["std"] == pytest.approx(np.hypot(0.5, 0.3))
    assert k1["tests"] == ["ring-down"]
    assert k1["limited_by"]["shares"]["clock"] == pytest.approx(0.09 / 0.34)
    assert facts["correlated"][0]["between"] == ["zeta1", "k1_N_per_m"]


def test_show_with_masses_and_without_kept_tests(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = kept(tmp_path / "p.toml")
    _, out, _ = run_rig(capsys, "parameters", "show", str(path), "--mass-std", "0.1%", "--json")
    answer = json.loads(out)["files"][0]["parameters"]
    assert answer["k1_N_per_m"]["limited_by"]["main"] == "mass"
    assert answer["k1_N_per_m"]["relative_std"] == pytest.approx(1e-3, rel=0.05)
    assert answer["zeta1"]["limited_by"]["shares"]["mass"] == 0
    bare = tmp_path / "bare.toml"
    IdentifiedParameters(VALUES, np.diag([s**2 for s in STD.values()])).save(bare)
    code, out, _ = run_rig(capsys, "parameters", "show", str(bare), str(path))
    assert code == 0
    assert "has too little" in out


def test_show_with_a_rig_lists_every_value_in_use_with_its_origin(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = kept(tmp_path / "p.toml")
    code, out, _ = run_rig(capsys, "parameters", "show", str(path), "--rig", "virtual")
    assert code == 0
    assert "SP_kg_m" in out
    assert "design value, not identified" in out
    _, out, _ = run_rig(capsys, "parameters", "show", str(path), "--rig", "virtual", "--json")
    used = json.loads(out)["files"][0]["in_use"]
    assert used["k1_N_per_m"] == {
        "name": "k1_N_per_m",
        "value": 2600.0,
        "std": pytest.approx(np.hypot(0.5, 0.3)),
        "unit": "N/m",
        "origin": "identified",
    }
    assert (used["SP_kg_m"]["origin"], used["rotor.mass_kg"]["origin"]) == ("design", "exact")
    assert used["SP_kg_m"]["std"] > 0.01 * used["SP_kg_m"]["value"]


@pytest.mark.parametrize("command", ["predict", "map", "plan"])
def test_commands_name_the_values_that_given_parameters_lack(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    path, more = kept(tmp_path / "p.toml"), []
    if command == "predict":
        more = ["--point", "C"]
    elif command == "map":
        more = ["--x", "speed_ratio=2:3:2", "--y", "suspension.zeta1=0.01:0.02:2", "-o", str(tmp_path / "m.npz")]
    else:
        more = ["--want", "k1=50%"]
    code, _, err = run_rig(
        capsys, command, "virtual", "--parameters", str(path), *more, "--set", "suspension.zeta2=0.02"
    )
    assert code == 0, err
    (line,) = [line for line in err.splitlines() if "design value" in line]
    assert "SP_kg_m" in line
    assert "zeta2" not in line  # it was set


def test_diff_states_what_changed_in_words(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    old, new = kept(tmp_path / "old.toml"), kept(tmp_path / "new.toml", {"k2_N_per_m": 1.05}, day=2)
    code, out, _ = run_rig(capsys, "parameters", "diff", str(old), str(new))
    assert code == 0
    assert out.startswith("k2 grew by 5.000 ± 0.030 %; nothing else changed significantly\n")
    assert "at 0.1 %" in out
    assert "N/m" in out
    code, out, _ = run_rig(capsys, "parameters", "diff", str(old), str(new), "--json")
    answer = json.loads(out)
    assert answer["words"].startswith("k2 grew")
    change = answer["changes"]["k2_N_per_m"]
    assert change["relative_change"] == pytest.approx(0.05)
    assert change["significant_at"] == 0.001
    assert answer["changes"]["zeta1"]["significant_at"] is None
    assert answer["overall"]["p"] < 1e-10
    _, out, _ = run_rig(capsys, "parameters", "diff", str(old), str(old))
    assert out.startswith("nothing changed significantly\n")


def test_history_marks_the_change_and_draws(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for day, factor in ((1, 1.0), (2, 1.00001), (3, 1.03)):
        kept(tmp_path / f"day{day}.toml", {"k1_N_per_m": factor}, day)
    figure = tmp_path / "history.svg"
    code, out, err = run_rig(capsys, "parameters", "history", str(tmp_path), "--plot", str(figure))
    assert code == 0
    assert "▲" in next(line for line in out.splitlines() if "day3.toml" in line)
    assert "▲" not in next(line for line in out.splitlines() if "day2.toml" in line)
    assert "first to last: k1 grew by 3.000" in out
    assert "drawn" in err
    text = figure.read_text(encoding="utf-8")
    assert "+3 %" in text
    assert "joint estimate" in text
    code, out, _ = run_rig(capsys, "parameters", "history", str(tmp_path), "--json")
    answer = json.loads(out)
    assert [i["time"][:10] for i in answer["instants"]] == ["2026-03-01", "2026-03-02", "2026-03-03"]
    assert answer["instants"][2]["change"]["changes"]["k1_N_per_m"]["significant_at"] == 0.001


def test_a_test_left_out_is_reported(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = kept(tmp_path / "p.toml", left_out="stands apart")
    _, out, _ = run_rig(capsys, "parameters", "show", str(path))
    assert "left out     ring-down (p.mcap) stands apart" in out


def with_slopes(path: Path) -> Path:
    """The same file with what a mass does to its values."""
    parameters = IdentifiedParameters.load(path)
    slope = np.array([v / 7.27 if not n.startswith("zeta") else 0.0 for n, v in parameters.values.items()])
    replace(parameters, by_number={"rotor.mass_kg": slope}).save(path)
    return path


def test_budget_of_parameters_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = kept(tmp_path / "p.toml")
    code, out, _ = run_rig(capsys, "parameters", "budget", str(path), "k1", "--json")
    assert code == 0
    answer = json.loads(out)
    assert list(answer["parameters"]) == ["k1_N_per_m"]
    k1 = answer["parameters"]["k1_N_per_m"]
    assert k1["u"] == pytest.approx(np.hypot(0.5, 0.3))
    assert sum(row["contribution"] ** 2 for row in k1["budget"]) == pytest.approx(k1["u"] ** 2)
    assert [row["source"] for row in k1["budget"]] == [
        "own: ring-down (p.mcap)",
        "clock laser_x",
        "beyond noise: ring-down (p.mcap)",
    ]
    assert set(k1["budget"][0]) >= {"source", "type", "distribution", "u", "sensitivity", "contribution", "nu"}
    assert k1["nu_eff"] is None
    assert k1["U95"] == pytest.approx(1.96 * k1["u"], rel=1e-4)
    assert answer["correlation"] == {"order": ["k1_N_per_m"], "matrix": [[1.0]]}
    code, out, _ = run_rig(capsys, "parameters", "budget", str(path), "--level", "0.99", "--monte-carlo")
    assert code == 0
    assert "U (99 %)" in out
    assert "own: ring-down (p.mcap)" in out
    assert "agree" in out
    assert "taken as exact" not in out


def test_budget_with_a_rig_shows_masses_points_and_what_is_exact(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = with_slopes(kept(tmp_path / "p.toml"))
    arguments = ("parameters", "budget", str(path), "k1", "D.theta3_deg", "--rig", "virtual")
    code, out, _ = run_rig(capsys, *arguments, "--set", "rotor.mass_std_kg=0.01", "--json")
    assert code == 0
    answer = json.loads(out)
    main = answer["parameters"]["k1_N_per_m"]["budget"][0]
    assert main["source"] == "known rotor.mass_kg"
    assert main["sensitivity"] == pytest.approx(2600 / 7.27)
    assert list(answer["predicted"]) == ["D.theta3_deg"]
    assert "known rotor.mass_kg" in [row["source"] for row in answer["predicted"]["D.theta3_deg"]["budget"]]
    assert answer["taken_as_exact"] == {}  # of the numbers that are exact this file has no derivatives
    assert answer["what_if"] == ["rotor.mass_std_kg=0.01"]
    code, out, _ = run_rig(capsys, *arguments, "B", "--json", "--monte-carlo", "--trials", "200")
    answer = json.loads(out)
    assert list(answer["predicted"]) == ["D.theta3_deg", "B.theta3_deg", "B.theta4_deg"]
    exact = answer["taken_as_exact"]["rotor.mass_kg"]["k1_N_per_m"]
    assert exact["percent"] == pytest.approx(0.1 * 7.0 / 7.27)
    assert exact["standard_uncertainties"] == pytest.approx(7e-3 * 2600 / 7.27 / np.hypot(0.5, 0.3))
    assert answer["without_budget"]["B.amplitude_mm"] == "it is 0 for all values of the parameters"
    sampled = answer["predicted"]["D.theta3_deg"]["monte_carlo"]
    assert sampled["trials"] == 200
    assert set(sampled["checks"]["shortest"]) >= {"d_low", "d_high", "tolerance", "verdict"}
    code, out, _ = run_rig(capsys, *arguments)
    assert "taken as exact: effect of 0.1 % of each number" in out
    assert "rotor.mass_kg" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["show"], "no file given"),
        (["show", "nothing.toml"], "nothing.toml: cannot be read"),
        (["show", "{p}", "--mass-std", "x"], "expected a share"),
        (["diff", "{p}", "nothing.toml"], "nothing.toml: cannot be read"),
        (["diff", "{p}", "{p}", "--level", "2"], "expected a number above 0 to 1"),
        (["history", "nothing.mcap"], "rig identify"),
        (["budget", "nothing.toml"], "nothing.toml: cannot be read"),
        (["budget", "{p}", "k7"], "no 'k7'; expected any of k1, k2, zeta1; points of a rig file need --rig"),
        (["budget", "{p}", "Q", "--rig", "virtual"], "no 'Q'; expected any of k1, k2, zeta1, A, B, C, D, E, A.theta3"),
        (["budget", "{p}", "--set", "rotor.mass_kg=7"], "give it with --rig"),
        (["budget", "{p}", "--level", "1.5"], "expected a number from 0.5"),
        (["budget", "{p}", "--trials", "1"], "expected a number from 100"),
        (["history", "{p}", "--rig", "other"], "no file is of rig 'other'"),
        (["history", "{p}", "--plot", "a.doc"], ".svg, .png or .pdf"),
        (["history", "{p}", "--plot", "nowhere/a.svg"], "the folder nowhere does not exist"),
    ],
)
def test_bad_use_is_explained(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], words: str
) -> None:
    path = kept(tmp_path / "p.toml")
    code, out, err = run_rig(capsys, "parameters", *(a.format(p=path) for a in arguments))
    assert code == 2
    assert words in " ".join((out + err).split())


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (2616.733, 0.074, ("2616.733", "0.074")),
        (38142.7, 120.0, ("38143", "120")),
        (0.02079886, 5.9e-7, ("0.02079886", "0.00000059")),
        (1.039974e-3, 4.3e-8, ("1.039974e-03", "0.000043e-03")),
        (0.0, 0.01, ("0.000", "0.010")),
        (5.0, 0.0, ("5", "0")),
    ],
)
def test_values_are_rounded_to_two_digits_of_their_uncertainty(
    value: float, std: float, shown: tuple[str, str]
) -> None:
    assert rounded(value, std) == shown


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["identify", "no.mcap", "-o"], "rig identify: -o"),
        (["validate", "virtual", "no.mcap", "--parameters", "no.toml", "--report"], "rig validate: --report"),
        (["predict", "virtual", "--speed-ratio", "2", "--plot"], "rig predict: --plot"),
        (["map", "virtual", "--x", "speed_ratio=1:2:3", "--y", "stiffness_ratio=1:2:3", "-o"], "rig map:"),
        (["log", "no.mcap", "--plot"], "rig log: --plot"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: list[str], option: str
) -> None:
    for place, why in (("nowhere/p.svg", "the folder nowhere does not exist"), (str(tmp_path), "this is a folder")):
        assert run([*command, place]) == 2
        words = " ".join(capsys.readouterr().err.split())
        assert f"{option} {place}" in words
        assert why in words


def test_a_log_is_not_taken_for_parameters(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert run(["parameters", "show", str(tmp_path / "a.mcap")]) == 2
    assert "this is a log; `rig identify` makes parameters of it" in " ".join(capsys.readouterr().err.split())
