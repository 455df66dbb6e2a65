"""`rig map` over any two numbers, with borders; what it refuses and why."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from analysis.maps.axes import MapAxis
from analysis.maps.families import BorderFamily
from analysis.maps.files import load_map
from analysis.maps.planes import plane_over
from dynamics import balanced_angles
from dynamics.stability.borders import stability_borders
from dynamics.stability.map_plane import Plane, RigPlane, SpeedStiffnessPlane
from rig_cli.main import run
from rig_cli.map_axes import read_axis
from rig_configs import RigFileError, load_rig

DAMPING = "pendulums.a.damping_Nms_per_rad+pendulums.b.damping_Nms_per_rad=1e-4:1e-2:12:log"


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_any_two_numbers_with_borders(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arrays, figure = tmp_path / "map.npz", tmp_path / "map.svg"
    code, out, _ = run_rig(
        capsys,
        "map",
        "virtual",
        "--x",
        "speed_ratio=1:2:20",
        "--y",
        DAMPING,
        "--borders",
        "--quantity",
        "decay-rate",
        "--plot",
        str(figure),
        "-o",
        str(arrays),
        "--json",
    )
    result = json.loads(out)
    assert (code, result["x"], result["points"]) == (0, "speed_ratio", 240)
    assert result["y"] == DAMPING.partition("=")[0]
    (border,) = result["borders"]
    assert set(border["kinds"]) == {"flutter"}
    with np.load(arrays) as found:
        line, multiplier = found["border_1"], found["border_1_multiplier"]
        rate, largest, speed = found["decay_rate_per_s"], found["multiplier_max"], found["speed_ratio"]
        damping = found["pendulums.a.damping_Nms_per_rad"]
    assert damping == pytest.approx(np.geomspace(1e-4, 1e-2, 12))
    assert np.abs(multiplier) == pytest.approx(1, abs=1e-10)
    assert rate == pytest.approx(
        -np.log(largest) * speed * 3.0, rel=0.01
    )  # ω_n1 of the nominal rig is 3 turns a second
    for row, value in enumerate(damping[1:-1], 1):
        at = np.interp(value, *line[np.argsort(line[:, 1])].T[::-1])
        assert np.array_equal(largest[row] < 1, speed > at)
    text = figure.read_text("utf-8")
    assert "decay rate, 1/s" in text
    assert "pendulum damping c3 = c4, N m s/rad" in text


def test_a_store_is_replaced_if_that_is_asked_for(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for points, force in ((3, []), (4, ["--force"])):
        arguments = [
            "--x",
            f"speed_ratio=2:6:{points}",
            "--y",
            "stiffness_ratio=4:12:2",
            "-o",
            str(tmp_path / "m.zarr"),
            *force,
        ]
        assert run_rig(capsys, "map", "virtual", *arguments)[0] == 0
        assert load_map(tmp_path / "m.zarr").grid["multiplier_max"].shape == (2, points)
    assert [path.name for path in tmp_path.iterdir()] == ["m.zarr"]


def test_words_state_what_was_found(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run_rig(
        capsys, "map", "virtual", "--x", "imbalance.radius_m=0.06:0.075:12", "--y", DAMPING, "--speed-ratio", "1.6"
    )
    assert code == 0
    assert "no balanced state exists on 50.0 %" in out
    assert "no file written" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--x", "imbalance.radius_m=0.01:0.02:5", "--y", DAMPING], "neither axis is a speed"),
        (["--x", "imbalance.radus_m=0.01:0.02:5"], "did you mean imbalance.radius_m"),
        (["--x", "imbalance.radius_m=0.5:2:5"], "imbalance.radius_m"),
        (["--x", "speed_ratio=1:2:5", "--y", "speed_rpm=100:200:5"], "both axes"),
        (["--x", "speed_ratio+speed_rpm=1:2:5"], "cannot change alike"),
        (["--x", "speed_ratio=0:2:5"], "0 < A < B"),
        (["--x", "suspension.zeta1=0:0.1:5:log"], "0 < A < B"),
        (["--x", "suspension.zeta1=0:0.1:5:lin"], "KEY=A:B:N:log"),
        (["--x", "suspension.zeta1=0:0.1:x"], "KEY=A:B:N"),
        (["--x", "suspension.zeta1=0.1:0.1:1", "--borders"], "span a range"),
        (["--family", "suspension.zeta1"], "--family expected KEY=V,V,V"),
        (["--family", "suspension.zeta1=0.1,x"], "--family expected KEY=V,V,V"),
        (["--family", "suspension.zeta1=0.1,0.1"], "values that rise"),
        (["--family", "suspension.zeta1=0.1,3"], "suspension.zeta1"),
        (["--family", "speed_ratio=1,2"], "speed_ratio"),
        (["--family", "suspension.k2_N_per_m=1e4,2e4"], "changes along an axis"),
        (["--best", "suspension.zeta1=0.1"], "--best expected KEY=A:B"),
        (["--best", "suspension.zeta1=0.2:0.1"], "A < B"),
        (["--best", "suspension.zeta1=0:0.1:log"], "0 < A < B"),
        (["--refine", "9"], "refine: expected 0 … 8"),
        (["--plot", "map.txt"], ".html"),
        (["-o", "map.csv"], ".npz, .parquet, .zarr"),
        (["--point", "Z"], "no point 'Z'"),
        (["--point", "A", "--speed-ratio", "2"], "expected one speed"),
        (["--x", "suspension.gravity_m_per_s2=0:9:4"], "gravity"),
    ],
)
def test_what_is_refused_states_why(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    y = ["--y", "speed_ratio=1:2:3"] if arguments[0] == "--x" and "speed" not in arguments[1] else []
    if "--y" in arguments:
        y = []
    code, _, err = run_rig(capsys, "map", "virtual", *arguments, *y)
    assert code in (1, 2)
    assert words in err


def plane(axes: tuple[MapAxis, MapAxis], settings: Sequence[str] = (), speed_rad_s: float | None = None) -> Plane:
    return plane_over(lambda further: load_rig("virtual", None, [*settings, *further]), axes, speed_rad_s)


def test_the_usual_plane_and_any_other_agree() -> None:
    axes = read_axis("--x", "speed_ratio=1.2:5:4"), read_axis("--y", "stiffness_ratio=2:9:3")
    usual = plane(axes)
    other = plane((axes[1], axes[0]))
    assert isinstance(usual, SpeedStiffnessPlane)
    assert isinstance(other, RigPlane)
    rig, _, speed = usual.one(1.7, 4.0)
    there, _, same_speed = other.one(4.0, 1.7)
    assert there == rig
    assert same_speed == pytest.approx(speed)


def test_a_speed_in_addition_to_the_axes_is_taken() -> None:
    axes = read_axis("--x", "suspension.zeta1=0.01:0.1:3"), read_axis("--y", "suspension.k2_N_per_m=1e4:4e4:3")
    rig, _, speed = plane(axes, ["suspension.zeta2=0.03"], 31.0).one(0.05, 2e4)
    assert (rig.zeta1, rig.zeta2, rig.k2_N_per_m, speed) == (0.05, 0.03, 2e4, 31.0)
    assert rig.k1_N_per_m == load_rig("virtual").physics.k1_N_per_m
    with pytest.raises(RigFileError, match="neither axis"):
        plane(axes)


def test_a_family_and_the_best_value(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    zetas = "suspension.zeta1+suspension.zeta2"
    file, page = tmp_path / "map.parquet", tmp_path / "map.html"
    code, out, _ = run_rig(
        capsys,
        "map",
        "virtual",
        "--x",
        "speed_ratio=2:6:9",
        "--y",
        "stiffness_ratio=4:12:9",
        "--refine",
        "2",
        "--family",
        f"{zetas}=0.2,0.05",
        "--best",
        f"{zetas}=0.02:1:log",
        "-o",
        str(file),
        "--plot",
        str(page),
        "--json",
    )
    assert code == 0
    result = json.loads(out)
    assert result["points"] == 33 * 33
    assert 0.05 < result["computed_share"] < 0.6
    members = result["family"]["members"]
    assert [member["value"] for member in members] == [0.05, 0.2]
    best = result["best"]
    assert best["interval"][0] <= best["value"] <= best["interval"][1]
    assert best["stable_share"] == max(best["stable_shares"])
    assert best["stable_share"] >= max(member["stable_share"] for member in members)
    kept = load_map(file)
    assert {line.value for line in kept.borders} == {0.05, 0.2}
    assert float(kept.grid["computed"].mean()) == pytest.approx(result["computed_share"])
    assert kept.question.family == BorderFamily(tuple(zetas.split("+")), (0.05, 0.2))
    physics = load_rig("virtual", settings=["suspension.zeta1=0.2", "suspension.zeta2=0.2"]).physics
    alone = SpeedStiffnessPlane(physics, balanced_angles(physics)[0])
    assert stability_borders(alone, (2.0, 6.0), (4.0, 12.0)).stable_share == members[1]["stable_share"]
    readout = re.search(r'id="readout">(.*?)</script>', page.read_text("utf-8"))
    assert readout
    assert json.loads(readout[1])["layers"][0]["name"].startswith("|multiplier|")


def test_stopped_it_states_what_is_lost(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    compile_first = ["map", "virtual", "--x", "speed_ratio=2:6:2", "--y", "stiffness_ratio=4:12:2"]
    run_rig(capsys, *compile_first)
    monkeypatch.setattr("analysis.maps.answers._full", stopped)
    code, out, err = run_rig(capsys, *compile_first, "--json")
    assert code == 130
    assert "the computed part is lost" in err
    assert json.loads(out)["error"]
