"""`rig demo`: the time on which a rig is simulated depends on whether its devices must be polled."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.demo import Simulation, _timed
from rig_cli.main import run
from rig_configs import load_rig
from tests.effort import thorough

POLLED = {
    "ethernet_lasers": "angle_bus",
    "analogue_lasers": "daq_box, radio_node",
}
NOT_POLLED = ("virtual", "other_devices", "by_hand", "one_laser", "can_lasers")


@pytest.mark.parametrize("name", POLLED)
def test_a_rig_that_must_be_polled_runs_on_simulated_time(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert _timed(Simulation(seed=3), load_rig(name)) == Simulation(seed=3, lockstep=True)
    assert f"simulated time, since {POLLED[name]} must be polled" in capsys.readouterr().err


@pytest.mark.parametrize("name", POLLED)
def test_chosen_wires_are_real_and_so_is_their_time(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    timed = _timed(Simulation(link="tcp"), load_rig(name))
    assert (timed.lockstep, timed.rate, timed.link) == (False, 1.0, "tcp")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", POLLED)
def test_a_scale_that_no_host_can_poll_at_is_warned_of(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    fast = Simulation(time_scale=4.0)
    assert _timed(fast, load_rig(name)) is fast
    assert f"warning: {POLLED[name]} must be polled, and this host does not poll 4 times" in capsys.readouterr().err
    slow = Simulation(time_scale=1.0)
    assert _timed(slow, load_rig(name)) is slow
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", NOT_POLLED)
def test_other_rigs_run_faster_than_real_time(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    timed = _timed(Simulation(), load_rig(name))
    assert (timed.lockstep, timed.rate) == (False, 8.0)
    stated = Simulation(time_scale=2.0)
    assert _timed(stated, load_rig(name)) is stated
    asked = Simulation(lockstep=True)
    assert _timed(asked, load_rig(name)) is asked
    assert capsys.readouterr().err == ""


@thorough
@pytest.mark.parametrize("name", [*POLLED, "can_lasers"])
def test_the_campaign_passes_without_options(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["demo", "--rig", name, "--out", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["passed"]
    assert set(result["points"]) == set("ABCDE")
    assert all(point["verdict"] == "pass" for point in result["points"].values())
