"""Locked motion in closed form, speed histories, and parameters that physics does not allow."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, locked_orbit, simulate
from dynamics.errors import OutsideDomain
from dynamics.motions.integrate import locked_state
from tests.dynamics.nominal import rig


def test_a_locked_pendulum_is_a_mass_on_the_rotor() -> None:
    """Locked at angle θ, it acts as an imbalance S e^{iθ}: the motion equals the linear steady orbit."""
    p, speed = rig(), 45.0
    start = locked_state(p, speed, 0.3, 0.7, 2.5)
    history = SpeedHistory.constant(speed, 0.3)
    times = np.linspace(0, 2.0, 201)
    motion = simulate(p, Scene(history, (False, False), start), times, 1e-11)
    x, y = locked_orbit(p, speed, 0.7, 2.5)
    turn = np.exp(1j * (0.3 + speed * times))
    assert np.allclose(motion.displacement_m, np.column_stack([(x * turn).real, (y * turn).imag]), atol=1e-10)
    assert np.allclose(motion.angles_rad, [0.7, 2.5])


def test_speed_history_of_a_ramp_is_a_ramp() -> None:
    history = SpeedHistory.ramp(0.0, 50.0, 10.0)
    phases = history.phase(np.array([0.0, 4.0, 10.0, 12.0]))
    assert np.allclose(phases[:, 0], [0, 40, 250, 350])
    assert np.allclose(phases[:3, 1], [0, 20, 50])
    marks = np.linspace(0, 10, 60)
    spline = SpeedHistory.from_phases(marks, 2.5 * marks**2)
    assert np.allclose(spline.phase(np.linspace(0, 10, 333))[:, 0], 2.5 * np.linspace(0, 10, 333) ** 2, atol=1e-9)
    with pytest.raises(OutsideDomain, match="at least 4"):
        SpeedHistory.from_phases(marks[:3], marks[:3])


def test_parameters_outside_physics_are_named() -> None:
    with pytest.raises(OutsideDomain, match="k1_N_per_m"):
        RotorParameters(7, 0.1, 0.02, Pendulum(0.1, 0.05, 0), Pendulum(0.1, 0.05, 0), -1.0, 1.0, 0, 0)
    with pytest.raises(OutsideDomain, match="friction_arm_m"):
        RotorParameters(7, 0.1, 0.02, Pendulum(0.1, 0.05, 0, -1e-6), Pendulum.absent(), 1.0, 1.0, 0, 0)
    ball = Pendulum(0.1, 0.05, 0, ball_radius_m=0.05)
    with pytest.raises(OutsideDomain, match="ball_radius_m"):
        RotorParameters(7, 0.1, 0.02, ball, Pendulum.absent(), 1.0, 1.0, 0, 0)


def test_histories_and_scenes_that_mean_nothing_are_refused() -> None:
    for make, word in (
        (lambda: SpeedHistory.ramp(0.0, 10.0, -1.0), "duration"),
        (lambda: SpeedHistory.constant(np.nan), "speed_rad_s"),
        (lambda: SpeedHistory.from_phases(np.array([0, 2, 1, 3.0]), np.arange(4.0)), "runs backwards"),
        (lambda: SpeedHistory.from_phases(np.arange(5.0), np.arange(4.0)), "a phase each"),
        (lambda: Scene(30.0), "SpeedHistory"),
        (lambda: Scene(SpeedHistory.constant(1.0), release_time_s=(np.nan, 0.5)), "release_time_s"),
        (lambda: Scene(SpeedHistory.constant(1.0), released="yes"), "released"),
    ):
        with pytest.raises(OutsideDomain, match=word):
            make()
