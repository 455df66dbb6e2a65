"""`open_rig` and `record`: a script records a rig in two calls, also when a device fails meanwhile."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daq.errors import LinkLost, LogError
from daq.log import open_log
from daq.recording import open_rig, record
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from tests.conftest import TIME_SCALE


def test_a_script_records_in_two_calls(virtual_rig: VirtualRigProcess, tmp_path: Path) -> None:
    rig = load_rig("virtual", settings=virtual_rig.port_settings())
    with open_rig(rig, time_scale=TIME_SCALE) as session:
        path = record(session, tmp_path / "run.mcap", 2.0, {"note": "two calls"})
        with pytest.raises(LogError, match="run"):
            record(session, path, 1.0)
        assert session.rotor_at_rest()
    with open_log(path) as log:
        laser = log["laser/x"]
        assert log.complete
        assert log.metadata["run"]["note"] == "two calls"
        assert json.loads(log.metadata["summary"]["ended"]) == "duration"
    assert laser.time_s[-1] - laser.time_s[0] == pytest.approx(2.0, abs=0.3)


def test_an_unplugged_device_ends_the_recording_with_its_reason(virtual_rig: VirtualRigProcess, tmp_path: Path) -> None:
    rig = load_rig("virtual", settings=virtual_rig.port_settings())
    session = open_rig(rig, time_scale=TIME_SCALE)
    virtual_rig.line.ask("unplug", device="laser_x")
    with pytest.raises(LinkLost, match="laser_x"), session:
        record(session, tmp_path / "run.mcap", 60.0)
    with open_log(tmp_path / "run.mcap") as log:
        assert "laser_x" in log.metadata["summary"]["ended"]
