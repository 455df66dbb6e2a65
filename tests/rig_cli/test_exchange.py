"""`rig export` and `rig import`, and that the rest of the house takes what was imported."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from dynamics import Scene, SpeedHistory, simulate
from dynamics.motions.integrate import locked_state
from rig_cli.main import run
from rig_configs import load_rig
from tests.daq.small_log import write_small_log

RIG = load_rig("virtual")


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def imported(capsys: pytest.CaptureFixture[str], file: Path, *options: object) -> Path:
    out = file.with_suffix(".mcap")
    code, answer, err = run_rig(capsys, "import", file, "--rig", "virtual", "-o", out, "--json", *options)
    assert code == 0, err
    assert json.loads(answer)["log"] == str(out)
    return out


def ring_down(k: float, zeta: float, amplitude_m: float, t: np.ndarray) -> np.ndarray:
    """A free decay in closed form, as an oscillator of the rig's mass shows it."""
    w = math.sqrt(k / RIG.physics.total_mass_kg)
    wave = w * math.sqrt(1 - zeta**2)
    return amplitude_m * np.exp(-zeta * w * t) * (np.cos(wave * t) + zeta * w / wave * np.sin(wave * t))


K1, K2, ZETA1, ZETA2 = 2616.0, 38140.0, 0.0208, 0.0193


def pluck(axis: str, seed: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    main, side = (2e-3, 2e-4) if axis == "x" else (2e-4, 2e-3)
    x, y = ring_down(K1, ZETA1, main, t), ring_down(K2, ZETA2, side, t)
    return x + 4e-6 * rng.normal(size=len(t)), y + 4e-6 * rng.normal(size=len(t))


def test_ring_downs_of_another_laboratory_are_identified(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    t = np.arange(12 * 2000) / 2000
    x, y = pluck("x", 1, t)
    german = tmp_path / "zupf.csv"
    lines = (f"{a:.1f};{b:.5f};{c:.5f}".replace(".", ",") for a, b, c in zip(t * 1e3, x * 1e3, -y * 1e6, strict=True))
    german.write_bytes(("Zeit;Weg 1;Weg 2\nms;mm;µm\n" + "\n".join(lines) + "\n").encode("latin-1"))
    x, y = pluck("y", 2, t)
    savemat(tmp_path / "pluck.mat", {"rec": {"t": t, "d": np.column_stack([x, y]) / 0.0254}})
    logs = [
        imported(
            capsys,
            german,
            "--test",
            "ring-down-x",
            "--time",
            "Zeit:ms",
            "--x",
            "Weg 1:mm",
            "--y",
            "Weg 2:-um",
            "--start",
            "2026-03-01T10:00:00",
        ),
        imported(
            capsys,
            tmp_path / "pluck.mat",
            "--test",
            "ring-down-y",
            "--time",
            "rec.t:s",
            "--x",
            "rec.d.1:in",
            "--y",
            "rec.d.2:in",
            "--clock-tolerance-ppm",
            "3",
        ),
    ]
    code, out, err = run_rig(capsys, "identify", *logs, "--rig", "virtual", "-o", tmp_path / "p.toml", "--json")
    assert code == 0, err
    found = json.loads(out)["parameters"]
    for name, true in (("k1_N_per_m", K1), ("k2_N_per_m", K2), ("zeta1", ZETA1), ("zeta2", ZETA2)):
        value, std = found[name]["value"], found[name]["std"]
        assert std < 0.01 * true
        assert abs(value - true) < 4 * std


def test_one_laser_gives_one_direction(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    t = np.arange(10 * 1000) / 1000
    logs = []
    for axis, signal in (("x", pluck("x", 3, t)[0]), ("y", pluck("y", 4, t)[1])):
        pq.write_table(pa.table({"d": signal * 1e3}), tmp_path / f"{axis}.parquet")
        options = ["--test", f"ring-down-{axis}", "--rate", 1000, f"--{axis}", "d:mm"]
        logs.append(imported(capsys, tmp_path / f"{axis}.parquet", *options))
    code, out, _ = run_rig(capsys, "identify", *logs, "--rig", "virtual", "-o", tmp_path / "p.toml", "--json")
    assert code == 0
    found = json.loads(out)["parameters"]
    assert list(found) == ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2"]
    for name, true in (("k1_N_per_m", K1), ("k2_N_per_m", K2), ("zeta1", ZETA1), ("zeta2", ZETA2)):
        assert abs(found[name]["value"] - true) < 4 * found[name]["std"]


BALANCED_COLUMNS = (
    "--time",
    "t:s",
    "--x",
    "x:mm",
    "--y",
    "y:mm",
    "--theta3",
    "a:deg",
    "--theta4",
    "b:deg",
    "--phase",
    "psi:deg",
    "--release",
    "5.0",
)
"""Options that import the file of `balanced_point`."""


def balanced_point(path: Path, rate: float = 1000.0) -> Path:
    """A point at which the pendulums, released at 5 s, move to balance: the model's motion with noise."""
    rng, physics = np.random.default_rng(5), RIG.physics
    t = np.arange(0, 60, 1 / rate)
    speed = 0.998 * physics.speed_rad_s(RIG.points["B"].speed_ratio)
    psi, locked = 0.4 + speed * t, t < 5.0
    history = SpeedHistory.constant(speed, 0.4)
    before = np.array([locked_state(physics, speed, at, 2e-3, math.pi - 3e-3) for at in psi[locked]])
    start = locked_state(physics, speed, 0.4 + 5.0 * speed, 2e-3, math.pi - 3e-3)
    after = simulate(physics, Scene(history, (True, True), start), t[~locked], 1e-4).state
    states = np.vstack([before, after])
    theta3, theta4 = (states[:, i] + 0.002 * rng.normal(size=len(t)) for i in (2, 3))
    x, y = (states[:, i] + 4e-6 * rng.normal(size=len(t)) for i in (0, 1))
    table = np.column_stack([t, x * 1e3, y * 1e3, np.degrees(theta3), np.degrees(theta4), np.degrees(psi) % 360])
    np.savetxt(path, table, "%.9g", delimiter=",", header="t,x,y,a,b,psi")
    return path


def test_a_point_of_another_laboratory_is_validated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log = imported(
        capsys,
        balanced_point(tmp_path / "b.csv"),
        "--point",
        "B",
        *BALANCED_COLUMNS,
    )
    toml = tmp_path / "p.toml"
    x_only = imported(
        capsys,
        half(balanced_point(tmp_path / "c.csv")),
        "--point",
        "B",
        "--time",
        "t:s",
        "--x",
        "x:mm",
        "--release",
        "5.0",
    )
    known(toml)
    code, out, err = run_rig(capsys, "validate", "virtual", log, x_only, "--parameters", toml, "--json")
    assert code in (0, 1), err
    points = json.loads(out)["points"]
    assert points["B"]["state"] == "I", points["B"]["why"]
    assert points["B"]["verdict"] == "pass", points["B"]["why"]
    assert points["B (2)"]["verdict"] == "not enough data"
    assert "tachometer marks" in points["B (2)"]["why"]


def half(path: Path) -> Path:
    """Without the last rows, so that it is another file."""
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-100]))
    return path


def known(toml: Path) -> None:
    from rig_configs import PARAMETER_UNITS, IdentifiedParameters

    values = RIG.physics.identified()
    ordered = {name: values[name] for name in PARAMETER_UNITS}
    std = np.array([1e-3 * abs(value) for value in ordered.values()])
    IdentifiedParameters(ordered, np.diag(std**2), {"method": "given", "tests": []}).save(toml)


def test_export_states_what_it_wrote(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log, out = write_small_log(tmp_path / "small.mcap"), tmp_path / "x.csv"
    code, answer, _ = run_rig(capsys, "export", log, "-o", out, "--channels", "laser/x", "--json")
    result = json.loads(answer)
    assert code == 0
    assert result["files"] == [str(out), f"{out}.json"]
    assert result["rows"] == {"laser/x": 400}
    assert result["missing"] == []
    code, _, err = run_rig(capsys, "export", log, "-o", out, "--channels", "laser/x")
    assert code == 2
    assert "(force)" in err
    code, answer, err = run_rig(
        capsys, "export", log, "-o", tmp_path / "s.h5", "--signals", "--from", "0.0", "--to", "2"
    )
    assert code == 0
    assert "marks" in answer
    assert answer.endswith(f" exported to {tmp_path / 's.h5'}.\n")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--x", "d:m"], "did you mean"),
        (["--x", "dd:mm"], "'t', 'd', got 'dd'"),
        (["--x", "d:mm", "--release", "x"], "release x: expected numbers"),
        (["--x", "d:mm", "--point", "B"], "point B: expected no test in addition"),
    ],
)
def test_bad_use_is_explained(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: list[str], words: str
) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t,d\n" + "".join(f"{i * 0.001!r},{i * 0.1!r}\n" for i in range(50)))
    code, _, err = run_rig(
        capsys,
        "import",
        file,
        "--rig",
        "virtual",
        "--test",
        "ring-down-x",
        "-o",
        tmp_path / "a.mcap",
        "--time",
        "t:s",
        *options,
    )
    assert code == 2
    assert words in " ".join(err.split())
    assert not (tmp_path / "a.mcap").exists()
