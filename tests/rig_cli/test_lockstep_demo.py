"""`rig demo --lockstep`: a campaign in one thread, with the verbs that run a real one."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from rig_cli.main import run


def test_a_rig_of_one_laser_does_what_it_can_and_the_same_each_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    digests = set()
    for out in ("first", "second"):
        words = ["demo", "--rig", "one_laser", "--lockstep", "--seed", "3", "--out", str(tmp_path / out), "--json"]
        assert run(words) == 0
        result = json.loads(capsys.readouterr().out)
        assert (result["passed"], result["not_reached"]) == (None, {})  # no sensors for a point: no verdict
        k1 = result["parameters"]["k1_N_per_m"]
        assert abs(k1["value"] - result["truth"]["k1_N_per_m"]) < 4 * k1["std"]
        (log,) = map(Path, result["logs"])
        digests.add(hashlib.sha256(log.read_bytes()).hexdigest())
    assert len(digests) == 1
