"""`rig track` of a bent rig's point: with the bow of a parameters file it agrees with the identification in it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.worlds import Effects, World, draw_world, record
from daq.acquisition.session import Session
from daq.lockstep.rig import LockstepRig
from rig_cli.main import run
from rig_cli.tracking import LiveTracking
from rig_configs import IdentifiedParameters, load_rig
from rig_configs.slow_roll import SlowRoll

SEED = 1000


@pytest.fixture(scope="module")
def world() -> World:
    return draw_world(SEED, effects=Effects(bow_m=1e-4))


@pytest.fixture(scope="module")
def parameters(tmp_path_factory: pytest.TempPathFactory, world: World) -> Path:
    """As a campaign finds them, c3 and c4 to half a per cent."""
    bow = world.mechanics.bow_m * np.exp(1j * world.mechanics.bow_rad)
    std = np.array([(5e-3 if n.startswith("c") else 1e-3) * v for n, v in world.truth.items()])
    roll = SlowRoll(0j, 0j, complex(bow), np.diag([0.0] * 4 + [1e-14] * 2), (0.5, 0.5))
    path = tmp_path_factory.mktemp("bent") / "p.toml"
    IdentifiedParameters(world.truth, np.diag(std**2), slow_roll=roll).save(path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, world: World) -> Path:
    folder, point = tmp_path_factory.mktemp("log"), record(world, SEED, "point-E", 12.0)
    table, marks, out = folder / "e.csv", folder / "marks.csv", folder / "e.mcap"
    rows = np.column_stack([point.angle_time_s, np.degrees(point.angle_rad)])
    np.savetxt(table, rows, "%.9g", delimiter=",", header="t,a,b", comments="")
    np.savetxt(marks, point.mark_time_s, "%.9f", header="mark", comments="")
    words = [
        "import",
        str(table),
        "--rig",
        "virtual",
        "--test",
        "point-E",
        "-o",
        str(out),
        "--time",
        "t:s",
        "--theta3",
        "a:deg",
        "--theta4",
        "b:deg",
        "--marks",
        f"{marks}:s",
        "--release",
        f"{point.releases[0].time_s:.6f}",
    ]
    assert run(words) == 0
    return out


def test_tracked_dampings_agree_with_the_identification(
    capsys: pytest.CaptureFixture[str], log: Path, parameters: Path
) -> None:
    capsys.readouterr()
    assert run(["track", str(log), "--parameters", str(parameters), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["logs"][0]
    assert found["trusted"]
    for name, own in found["parameters"].items():
        assert abs(own["known"]["z"]) < 2, name
        low, high = own["interval95"]
        assert high < 1.5 * low


def test_a_test_that_is_tracked_has_the_bow_too(world: World, parameters: Path) -> None:
    sim = LockstepRig(load_rig("virtual"))
    with Session(load_rig("virtual", settings=sim.port_settings()), sim.clock, edge=sim.edge) as session:
        bent, straight = (LiveTracking(session, parameters=path)._tracker.physics for path in (parameters, None))
    assert (abs(bent.bow_m), abs(straight.bow_m)) == (pytest.approx(1e-4), 0.0)
