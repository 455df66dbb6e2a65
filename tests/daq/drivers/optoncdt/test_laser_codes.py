"""Error codes in place of distances are shown with their meaning, while a log is recorded and by the checks."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.drivers.optoncdt.driver import DRIVER
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from tests.daq.acquisition.test_rig_check import checked, failed
from tests.daq.drivers.optoncdt.test_lost_set_up import opened


@pytest.mark.parametrize(("code", "meaning"), [(262076, "no peak"), (262082, "laser is off"), (262090, "")])
def test_the_driver_has_the_codes_of_the_manual(code: int, meaning: str) -> None:
    assert DRIVER.code_meaning(code) == meaning


@pytest.mark.parametrize(("code", "shown"), [(262082, "code 262082 (laser is off)"), (262090, "code 262090")])
def test_a_log_states_why_a_laser_measures_nothing(tmp_path: Path, code: int, shown: str) -> None:
    sim, session = opened()
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.ask("fail", device="laser_x", what="code", value=code, seconds=1.0)
        sim.clock.wait(2.0)
        session.stop_recording({})
    with open_log(tmp_path / "a.mcap") as log:
        texts = [event["text"] for event in log.events if event["kind"] == "blind"]
    assert texts == [f"laser/x: no valid sample, {shown}", "laser/x: valid samples again"]


def test_a_check_states_why_a_laser_measures_nothing() -> None:
    def switch_off(far: LockstepRig) -> None:
        far.ask("fail", device="laser_x", what="code", value=262082)

    found = checked(prepare=switch_off)
    assert "laser_x invalid_samples" in failed(found)
    assert found["laser_x"]["error_code"].value == "262082: laser is off"
    assert found["laser_x"]["error_code"].note.endswith(
        " samples: switch the laser on: LASERPOW FULL, its web page, or its input"
    )
    assert "error_code" not in found["laser_y"]
