"""`open_rig` and `record`: a script records a rig in two calls, also when a device fails during the recording."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daq import open_rig, record
from daq.errors import DeviceError, LogError
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from rig_configs.schema import Rig
from tests.conftest import join


@pytest.fixture(autouse=True)
def joined(simulated: LockstepRig, monkeypatch: pytest.MonkeyPatch) -> None:
    join(monkeypatch, "daq.recording", simulated)


def test_a_script_records_in_two_calls(cabled: Rig, tmp_path: Path) -> None:
    with open_rig(cabled) as session:
        path = record(session, tmp_path / "run.mcap", 2.0, {"note": "two calls"})
        with pytest.raises(LogError, match="run"):
            record(session, path, 1.0)
        assert session.rotor.at_rest()
    with open_log(path) as log:
        laser = log["laser/x"]
        assert log.complete
        assert log.metadata["run"]["note"] == "two calls"
        assert json.loads(log.metadata["summary"]["ended"]) == "duration"
    span_s = laser.time_s[-1] - laser.time_s[0]
    assert 1.7 < span_s < 2.5


def test_a_fault_during_the_recording_closes_the_log_with_its_reason(
    cabled: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = iter([None] * 20)

    def check() -> None:
        if next(looks, "over") == "over":
            raise DeviceError("drive: no answer for 0.5 s")

    with open_rig(cabled) as session:
        monkeypatch.setattr(session, "check", check)
        with pytest.raises(DeviceError, match="no answer"):
            record(session, tmp_path / "run.mcap", 60.0)
    with open_log(tmp_path / "run.mcap") as log:
        assert "no answer" in json.loads(log.metadata["summary"]["ended"])
        assert len(log["laser/x"]) > 0
