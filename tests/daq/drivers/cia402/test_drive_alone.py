"""A rig whose drive alone measures the rotor: after the loss of its line nothing else shows whether the rotor turns."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from daq.acquisition.session import Session
from daq.errors import LinkLost
from daq.lockstep.rig import LockstepRig
from rig_configs import load_rig

SHIPPED = Path(__file__).parents[4] / "rig_configs" / "virtual.toml"


def test_a_drive_that_ignores_the_missing_host_is_stopped_when_its_adapter_is_plugged_in_again(tmp_path: Path) -> None:
    text = SHIPPED.read_text()
    for device in ("laser_x", "laser_y", "encoder"):
        text = re.sub(rf"\[devices\.{device}\].*?(?=\n\[)", "", text, flags=re.DOTALL)
    path = tmp_path / "alone.toml"
    path.write_text(text)
    sim = LockstepRig(load_rig(path))
    with (  # noqa: PT012
        pytest.raises(LinkLost),
        Session(load_rig(path, settings=sim.port_settings()), sim.clock, edge=sim.edge) as session,
    ):
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        session.drive.enable()
        session.drive.set_speed(300)
        session.wait_for(lambda: session.drive.actual_rpm > 290, 5.0, "the speed")
        sim.ask("fail", device="drive", what="time-out", value=1000)
        sim.clock.after(0.2, lambda: sim.ask("unplug", device="drive"), world=True)
        sim.clock.after(3.0, lambda: sim.ask("plug", device="drive"), world=True)
        session.wait_for(lambda: False, 2.0, "the loss")
    assert abs(sim.far.motion.speed_rad_s) < 0.1
