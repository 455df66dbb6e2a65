"""`rig track`: a made-up spin-down through import, both settings, files, and what is refused."""

from __future__ import annotations

import json
import math
import shutil
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from rig_cli.main import run
from rig_configs import IdentifiedParameters, load_rig

C3, C4 = 1.6e-3, 7e-4
RIG = load_rig("virtual").physics
ANGLES = ["--theta3", "a:deg", "--theta4", "b:deg"]


def made(folder: Path, name: str, *columns: str, test: str = "spin-down", flick_rad_s: float = 10.0) -> Path:
    """A log in which both pendulums are flicked on a resting rotor; the disk, a hundred times heavier, stands."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 2.5, 2e-3)
    since = np.clip(t - 0.5, 0.0, None)
    angles: list[np.ndarray] = []
    for start, sense, c, p in ((0.0, 1, C3, RIG.a), (math.pi, -1, C4, RIG.b)):
        rate = c / p.inertia_kg_m2
        turned = sense * flick_rad_s / rate * (1 - np.exp(-rate * since))
        angles.append(np.degrees(start + turned + 5e-4 * rng.normal(size=len(t))))
    x = 4e-3 * rng.normal(size=len(t))
    table, out = folder / f"{name}.csv", folder / f"{name}.mcap"
    np.savetxt(
        table, np.column_stack([t, *angles, x, 0.4 + 0 * t]), "%.9g", delimiter=",", header="t,a,b,x,psi", comments=""
    )
    words = ["import", str(table), "--rig", "virtual", "--test", test, "-o", str(out), "--time", "t:s", *columns]
    assert run(words) == 0
    return out


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("track"), "flicks", *ANGLES, "--x", "x:mm")


def known(path: Path) -> Path:
    values = {"c3_Nms_per_rad": C3, "c4_Nms_per_rad": C4}
    IdentifiedParameters(values, np.diag([(0.01 * v) ** 2 for v in values.values()]), {"tests": []}).save(path)
    return path


def tracked(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    capsys.readouterr()
    code = run(["track", *map(str, words), "--json"])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return json.loads(captured.out)


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    capsys.readouterr()
    assert run(["track", *map(str, words)]) == 2
    return " ".join(capsys.readouterr().err.split())


def test_both_settings_find_the_dampings_and_write_table_and_figure(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    toml = known(tmp_path / "p.toml")
    out = tmp_path / "out"
    found = tracked(capsys, log, "-o", out)["logs"][0]
    assert found["trusted"]
    assert found["warnings"] == []
    for name, true in (("c3_Nms_per_rad", C3), ("c4_Nms_per_rad", C4)):
        own = found["parameters"][name]
        assert own["interval95"][0] < true < own["interval95"][1] < 2 * own["interval95"][0]
        assert own["start"] == pytest.approx(1e-3)
        assert own["known"] is None
    assert found["readings"]["used"] + found["readings"]["refused"] > 2000
    assert found["readings"]["refused"] >= 60  # the flicks
    file = pq.read_table(out / "flicks.track.parquet")
    fast = {name: file[name].to_numpy() for name in file.column_names}
    assert len(fast["time_s"]) == found["rows"]
    assert fast["c3_Nms_per_rad"][-1] == found["parameters"]["c3_Nms_per_rad"]["value"]
    units = json.loads(file.schema.metadata[b"units"])
    assert (units["theta3_rate_rad_per_s"], units["std_c3_Nms_per_rad"], units["x_m"]) == ("rad/s", "N m s/rad", "m")
    assert "smoothed_x_m" not in fast
    svg = (out / "flicks.track.svg").read_text(encoding="utf-8")
    assert "filtered, 95 %" in svg
    assert "rig file" in svg

    place = tmp_path / "slow.csv"
    slow = tracked(
        capsys,
        log,
        "--setting",
        "reference",
        "--parameters",
        toml,
        "--set",
        "pendulums.a.damping_Nms_per_rad=1e-3",
        "--set",
        "pendulums.b.damping_Nms_per_rad=1e-3",
        "-o",
        place,
    )["logs"][0]
    assert slow["files"] == [str(place), str(place.with_suffix(".svg"))]
    assert slow["smoother"] == {"stretches": 1, "filter_kept_share": 0.0}
    rows = np.genfromtxt(place, delimiter=",", names=True)
    assert rows["c3_Nms_per_rad"] == pytest.approx(fast["c3_Nms_per_rad"], rel=1e-9)
    assert rows["theta4_rad"] == pytest.approx(fast["theta4_rad"], rel=1e-9)
    assert rows["smoothed_low_c3_Nms_per_rad"][0] < C3 < rows["smoothed_high_c3_Nms_per_rad"][0]
    assert abs(slow["parameters"]["c3_Nms_per_rad"]["known"]["z"]) < 3
    svg = place.with_suffix(".svg").read_text(encoding="utf-8")
    assert all(text in svg for text in ("smoothed, 95 %", "p.toml, 95 %", "x, mm", "c4, N m s/rad"))


def test_the_summary_names_values_readings_and_trust(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    capsys.readouterr()
    assert run(["track", str(log), "--parameters", str(known(tmp_path / "p.toml"))]) == 0
    text = capsys.readouterr().out
    assert "c3 0.0015" in text
    assert "p.toml 0.0016 ± 2e-05, z " in text
    assert ", rejected " in text
    assert text.splitlines()[-1].startswith("trusted: ")


def test_pendulums_that_stand_show_no_damping(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    found = tracked(capsys, made(tmp_path, "still", *ANGLES, flick_rad_s=0.0))["logs"][0]
    assert not found["trusted"]
    assert [found["parameters"][n]["learned"] for n in found["parameters"]] == [False, False]
    assert "almost no information on c3" in found["warnings"][0]


def test_logs_that_cannot_be_tracked_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    locked = made(tmp_path, "locked", "--x", "x:mm", test="ring-down-x")
    assert "expected angles of both pendulums, the log has 0 readings" in refused(capsys, locked)
    up = made(tmp_path, "up", *ANGLES, "--x", "x:mm", "--phase", "psi:deg", test="run-up")
    assert "expected a test in which the pendulums swing, a run-up keeps them locked" in refused(capsys, up)
    point = made(tmp_path, "point", *ANGLES, "--x", "x:mm", "--release", "0.5", test="point-B")
    assert "expected index marks, because the rotor turns in a point-B; the log has 0" in refused(capsys, point)


def test_another_rig_s_file_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path) -> None:
    text = resources.files("rig_configs").joinpath("virtual.toml").read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    other.write_text(text.replace("counts_per_revolution = 4096", "counts_per_revolution = 1024"), encoding="utf-8")
    assert other.read_text(encoding="utf-8") != text
    text = refused(capsys, log, "--rig", other)
    assert f"counts_per_revolution of pendulums: 1024 in {other}, 4096 in flicks.mcap" in text
    assert tracked(capsys, log, "--rig", "virtual")["logs"][0]["trusted"]


def test_places_are_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig_cli.track._tracked", lambda *_: pytest.fail("a log was tracked"))
    assert "expected a folder, a table" in refused(capsys, log, "-o", tmp_path / "a.txt")
    same_name = tmp_path / "other" / log.name
    same_name.parent.mkdir()
    shutil.copy(log, same_name)
    assert "one file for several logs; give a folder" in refused(capsys, log, same_name, "-o", tmp_path / "a.csv")
    assert "several logs would be written to" in refused(capsys, log, same_name, "-o", tmp_path)
    (tmp_path / "a.csv").write_text("mine", encoding="utf-8")
    assert "exists already" in refused(capsys, log, "-o", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text(encoding="utf-8") == "mine"
    assert "expected 1 to 1000 ms" in refused(capsys, log, "--every-ms", "0")
    assert "usage: rig track LOG" in refused(capsys)
