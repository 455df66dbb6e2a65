"""The simulated rig without I/O and clock."""

from __future__ import annotations

import hashlib

import pytest

from daq.transports.can_frames import open_bus
from daq.virtual_rig.rig import SimulatedRig
from rig_configs import RigConfigError, load_rig

LASER_ON = b"OUTADD_RS422 COUNTER TIMESTAMP\nOUTPUT RS422\n"


def bytes_of(seed: int, steps: int = 200) -> dict[str, str]:
    """A digest of what each device sent while the column was plucked."""
    rig = SimulatedRig(load_rig("virtual", settings=[f"virtual.seed={seed}"]))
    sent = {name: hashlib.sha256() for name in rig.far_ends}
    for i in range(steps):
        now_s = 0.0021 * (i + 1)
        if i == 5:
            rig.do({"do": "pluck", "x_mm": 2.0, "hold_s": 0.1}, now_s)
        for name, data in rig.step(now_s, {"laser_x": LASER_ON, "drive": open_bus(500_000)} if i == 0 else {}).items():
            sent[name].update(data)
    return {name: digest.hexdigest() for name, digest in sent.items()}


def test_a_seed_gives_the_same_bytes_again_and_another_seed_others() -> None:
    first = bytes_of(3)
    assert first == bytes_of(3)
    other = bytes_of(4)
    assert first["laser_x"] != other["laser_x"]
    assert first["encoder"] != other["encoder"]


def test_answers_come_with_the_step_and_requests_move_the_rig() -> None:
    rig = SimulatedRig(load_rig("virtual"))
    sent = rig.step(0.01, {"laser_x": b"GETINFO\n"})
    assert set(sent) == set(rig.far_ends)
    assert b"ILD1420" in sent["laser_x"]
    assert sent["laser_y"] == b""
    rig.do({"do": "pluck", "x_mm": 2.0, "hold_s": 0.5}, 0.01)
    assert rig.step(0.3, {})["laser_y"] == b""
    assert rig.motion.advance(0.4).rows[-1, 0] == pytest.approx(2e-3)
    assert rig.do({"do": "state"}, 0.4)["time_s"] == pytest.approx(0.4)


def test_manual_actions_of_a_device_and_rigs_without_virtual_table_are_refused() -> None:
    rig = SimulatedRig(load_rig("virtual"))
    for act in ("lock", "release"):
        with pytest.raises(ValueError, match="encoder carries out this action"):
            rig.do({"do": act}, 0.0)
    with pytest.raises(ValueError, match="drive carries out this action"):
        rig.do({"do": "turn", "rpm": 60, "ramp_rpm_per_s": 20}, 0.0)
    with pytest.raises(ValueError, match="unknown request 'quit'"):
        rig.do({"do": "quit"}, 0.0)
    with pytest.raises(RigConfigError, match="which the simulation needs"):
        SimulatedRig(load_rig("virtual").model_copy(update={"virtual": None}))
