"""The simulated rig with dry friction: fixed steps compared with the integrator that locates every stop and start."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.virtual_rig.motion import GRID_S, SimulatedMotion
from dynamics import Scene, SpeedHistory, simulate
from rig_configs import load_rig

_RPM = math.pi / 30
_PLAY, _PLAY_B = 1.0, 0.4


def _released(arm_m: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Pendulum angles after a release at 600 rpm: the simulated rig's and those of `simulate`, shape (n, 2) each."""
    rig = load_rig("isotropic").physics
    p = replace(rig, a=replace(rig.a, friction_arm_m=arm_m), b=replace(rig.b, friction_arm_m=arm_m))
    motion = SimulatedMotion(p, 0.0, 0.001)
    for pendulum, play in ((0, _PLAY), (1, _PLAY_B)):
        motion.lock(pendulum, play)
    motion.target_rad_s, motion.ramp_rad_s2 = 600 * _RPM, 1000.0
    motion.advance(8.0)
    start = motion._last.copy()
    for pendulum in (0, 1):
        motion.release(pendulum)
    found = motion.advance(8.0 + seconds)
    times = np.arange(0.0, seconds - 0.01, 40 * GRID_S)
    scene = Scene(SpeedHistory.constant(start[9], start[8]), (True, True), start[:8])
    exact = simulate(p, scene, times, 1e-7).state
    assert np.all(np.diff(found.time_s) > 0)
    return found.rows[::40, 2:4][: len(times)], exact[:, 2:4]


@pytest.mark.parametrize("arm_m", [0.0, 2e-5, 8e-5])
def test_fixed_steps_follow_the_located_ones(arm_m: float) -> None:
    own, exact = _released(arm_m, 6.0)
    assert np.ptp(exact, axis=0).max() > 0.15, "the pendulums move"
    assert np.abs(own - exact).max() < (1e-6 if arm_m == 0.0 else 5e-4)


def test_friction_holds_pendulums_next_to_their_balance() -> None:
    held, exact = _released(6e-4, 6.0)
    assert np.ptp(held, axis=0).max() == 0.0
    assert held[0] == pytest.approx([_PLAY, math.pi + _PLAY_B])
    assert held == pytest.approx(exact)
    creeping, _ = _released(8e-5, 6.0)
    smooth, _ = _released(0.0, 6.0)
    assert np.abs(creeping[-1] - smooth[-1]).max() > math.radians(3)
