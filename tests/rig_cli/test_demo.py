"""`rig demo`: a campaign on simulated time in one thread, or in real time over ports, with the verbs of a real rig."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from rig_cli.main import run
from tests.effort import thorough


@pytest.fixture
def campaign(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Any:
    """Run the demo of a rig of one laser, which has no sensors for a point and therefore no verdict."""

    def demo(out: str, *options: str) -> Path:
        words = ["demo", "--rig", "one_laser", "--seed", "3", "--out", str(tmp_path / out), "--json", *options]
        assert run(words) == 0
        result = json.loads(capsys.readouterr().out)
        assert (result["passed"], result["not_reached"]) == (None, {})
        k1 = result["parameters"]["k1_N_per_m"]
        assert abs(k1["value"] - result["truth"]["k1_N_per_m"]) < 4 * k1["std"]
        (log,) = map(Path, result["logs"])
        return log

    return demo


def test_a_rig_of_one_laser_does_what_it_can_and_the_same_each_time(campaign: Any) -> None:
    digests = {hashlib.sha256(campaign(out).read_bytes()).hexdigest() for out in ("first", "second")}
    assert len(digests) == 1


@pytest.mark.lengthy
@pytest.mark.parametrize("link", ["auto", pytest.param("tcp", marks=thorough)])
def test_the_same_campaign_in_real_time_over_ports(link: str, campaign: Any) -> None:
    campaign("ports", "--real-time", "--link", link)


def test_wires_require_real_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["demo", "--link", "pty", "--out", str(tmp_path / "out")]) == 2
    assert "--link pty: expected --real-time too" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@thorough
@pytest.mark.parametrize("name", ["ethernet_lasers", "analogue_lasers", "can_lasers", "other_devices"])
def test_the_campaign_passes_without_options(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["demo", "--rig", name, "--out", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["passed"]
    assert set(result["points"]) == set("ABCDE")
    assert all(point["verdict"] == "pass" for point in result["points"].values())
