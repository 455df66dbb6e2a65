"""Start-ups from rest by the model: where they end, with and without friction."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, balanced_angles, locked_orbit, simulate
from dynamics.errors import OutsideDomain
from dynamics.motions.friction_steps import fixed_states
from dynamics.motions.start_ups import random_starts, start_ups_from_rest
from dynamics.steady.stick_band import held_share
from rig_configs import load_rig
from tests.dynamics.nominal import rig

SPEED = 600 * math.pi / 30


def _pendulums(arm_m: float) -> RotorParameters:
    p = rig(1.0, zeta=0.05)
    return replace(p, a=replace(p.a, friction_arm_m=arm_m), b=replace(p.b, friction_arm_m=arm_m))


def test_without_friction_every_start_up_ends_balanced() -> None:
    p = _pendulums(0.0)
    found = start_ups_from_rest([p] * 4, SPEED, 5.0, random_starts(4, 1))
    images = [np.sort(image) for image in np.array(balanced_angles(p))]
    for theta in found.theta_rad:
        assert min(np.abs(np.sort(theta) - image).max() for image in images) < 1e-3
    assert found.amplitude_m.max() < 1e-6
    assert found.followed.all()


def test_with_friction_each_end_is_one_that_friction_holds_and_its_orbit_the_locked_one() -> None:
    p = _pendulums(1e-4)
    found = start_ups_from_rest([p] * 4, SPEED, 5.0, random_starts(4, 1))
    assert found.drift_rad.max() < 1e-12
    for (a, b), amplitude in zip(found.theta_rad.tolist(), found.amplitude_m, strict=True):
        assert max(held_share(p, SPEED, (a, b))) < 1.001
        x, y = locked_orbit(p, SPEED, a, b)
        assert amplitude == pytest.approx([abs(x), abs(y)], rel=1e-3)
    assert found.amplitude_m.min() > 1e-5
    assert max(held_share(p, SPEED, (0.5, 1.0))) > 1, "and not every place is one"


def test_balls_that_cannot_be_followed_are_marked_and_have_an_end() -> None:
    ball = Pendulum(0.0138, 0.114, 3e-5, ball_radius_m=0.0075)
    p = replace(load_rig("ball_balancer").physics, a=ball, b=ball)
    found = start_ups_from_rest([p], 1500 * math.pi / 30, 12.5, random_starts(1, 3))
    assert not found.followed[0]
    assert np.isfinite(found.theta_rad).all()


def test_fixed_steps_are_those_of_the_integrator() -> None:
    p = _pendulums(5e-5)
    scene = Scene(SpeedHistory.ramp(0.0, SPEED, 4.0), (True, True), np.r_[0.0, 0.0, 0.3, 2.0, np.zeros(4)])
    times = np.linspace(0.0, 12.0, 60)
    exact = simulate(p, scene, times, 1e-7).state
    own = fixed_states(p, scene, times, 1e-4)
    assert np.abs(own - exact)[:, 2:4].max() < 2e-3
    coarse = fixed_states(p, scene, times, 2e-3)
    assert np.abs(coarse - exact)[:, 2:4].max() > np.abs(own - exact)[:, 2:4].max()


def test_refusals() -> None:
    p = _pendulums(0.0)
    with pytest.raises(OutsideDomain, match=r"expected shape \(2, 2\), a row a start-up"):
        start_ups_from_rest([p, p], SPEED, 5.0, np.zeros((3, 2)))
    with pytest.raises(OutsideDomain, match="ramp_s must be finite and above 0"):
        start_ups_from_rest([p], SPEED, 0.0, np.zeros((1, 2)))
    with pytest.raises(OutsideDomain, match="expected a scene with a start state and free pendulums"):
        fixed_states(p, Scene(SpeedHistory.constant(1.0)), np.array([0.0, 1.0]), 1e-3)
