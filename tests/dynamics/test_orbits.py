"""Harmonic balance: spectral convergence, the same orbit from any guess, and None if it does not exist."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dynamics.equations.parameters import RotorParameters
from dynamics.motions.integrate import locked_orbit
from dynamics.steady.orbits import periodic_orbit
from dynamics.steady.singular_points import singular_points
from tests.dynamics.nominal import from_domain, rig


def guess(p: RotorParameters, speed: float, theta: tuple[float, float], n: int = 16) -> np.ndarray:
    x, y = locked_orbit(p, speed, *theta)
    turn = np.exp(2j * np.pi * np.arange(n) / n)
    return np.column_stack([(x * turn).real, (y * turn).imag, np.full(n, theta[0]), np.full(n, theta[1])])


def test_doubling_the_phases_squares_the_error() -> None:
    p = rig()
    speed = p.speed_rad_s(3.3)
    point = next(s for s in singular_points(p, speed) if s.type == "III")
    loose = periodic_orbit(p, speed, guess(p, speed, point.theta_rad), 1e-4)
    tight = periodic_orbit(p, speed, guess(p, speed, point.theta_rad), 1e-13)
    assert loose is not None
    assert tight is not None
    assert len(loose.states) < len(tight.states)

    def error(states: np.ndarray) -> float:
        return float(np.max(np.abs(states[:, 2:4] - tight.states[:: len(tight.states) // len(states), 2:4])))

    coarse, fine = error(loose.coarse_states), error(loose.states)
    assert fine < 0.1 * coarse, "what is left of 4e-13 is rounding"
    assert 0.5 * coarse < loose.angle_error_rad < 2 * coarse, "what is stated is what doubling changed"
    assert fine <= loose.angle_error_rad <= 1e-4


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.sampled_from([12, 16, 30, 64]))
@settings(max_examples=25)
def test_guesses_nearby_reach_the_same_orbit(da: float, db: float, n: int) -> None:
    p = rig()
    speed = p.speed_rad_s(0.83)
    point = next(s for s in singular_points(p, speed) if s.type == "III")
    known = periodic_orbit(p, speed, guess(p, speed, point.theta_rad), 1e-12)
    a, b = point.theta_rad
    other = periodic_orbit(p, speed, guess(p, speed, (a + da, b + db), n), 1e-12)
    assert known is not None
    assert other is not None
    assert np.allclose(np.exp(1j * known.states[0, 2:4]), np.exp(1j * other.states[0, 2:4]), atol=1e-11)


def test_half_a_revolution_repeats_with_the_sign_turned_and_gravity_breaks_that() -> None:
    for g in (0.0, 9.81):
        p = rig(gravity_m_per_s2=g)
        speed = p.speed_rad_s(5.8)
        point = next(s for s in singular_points(p, speed) if s.type == "III")
        orbit = periodic_orbit(p, speed, guess(p, speed, point.theta_rad), 1e-9)
        assert orbit is not None
        half = len(orbit.states) // 2
        apart = np.max(np.abs(orbit.states[:half, 2:4] - orbit.states[half:, 2:4]))
        assert (apart < 1e-12) == (g == 0.0)


def test_a_locked_rotor_is_the_closed_form() -> None:
    p = rig()
    speed = p.speed_rad_s(2.0)
    start = guess(p, speed, (0.4, 1.9))
    orbit = periodic_orbit(p, speed, 0.5 * start + [0, 0, 0.2, 0.95], 1e-12, (False, False))
    assert orbit is not None
    x, y = locked_orbit(p, speed, 0.4, 1.9)
    turn = np.exp(2j * np.pi * np.arange(len(orbit.states)) / len(orbit.states))
    assert np.allclose(orbit.states[:, 0], (x * turn).real, atol=1e-15)
    assert np.allclose(orbit.states[:, 1], (y * turn).imag, atol=1e-15)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_orbits_are_found_over_the_whole_domain(seed: int) -> None:
    p, ratio = from_domain(np.random.default_rng(seed))
    speed = p.speed_rad_s(ratio)
    for point in singular_points(p, speed):
        if point.type == "I" or not np.isfinite(point.z_m):
            continue
        orbit = periodic_orbit(p, speed, guess(p, speed, point.theta_rad), 1e-9)
        if orbit is not None:
            assert np.all(np.isfinite(orbit.states))
            assert orbit.angle_error_rad <= 1e-9


@pytest.mark.parametrize("accuracy", [1e-6, 1e-12])
def test_a_guess_of_nonsense_gives_none(accuracy: float) -> None:
    p = rig()
    assert periodic_orbit(p, 30.0, np.full((16, 4), np.nan), accuracy) is None
