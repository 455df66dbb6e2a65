"""A bent shaft: its springs rest at a place that turns with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from nominal import rig
from scipy.integrate import solve_ivp

from dynamics import RotorParameters, SpeedHistory, simulate, steady_states
from dynamics.equations.scene import Scene
from dynamics.errors import OutsideDomain
from dynamics.motions.integrate import locked_orbit, locked_state
from dynamics.motions.locked_motion import locked_state_derivatives
from dynamics.steady.singular_points import bow_moment

BOW = {"bow_x_m": 8e-5, "bow_y_m": -6e-5}


def by_hand(p: RotorParameters, speed: float, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The locked rotor's motion, x, y and rates, from its equation written down here."""
    mass, (c1, c2), b = p.total_mass_kg, p.damping_Ns_per_m, complex(p.bow_x_m, p.bow_y_m)
    moment = p.imbalance_moment_kg_m + p.a.first_moment_kg_m - p.b.first_moment_kg_m

    def right(t: float, y: np.ndarray) -> list[float]:
        turn = np.exp(1j * speed * t)
        rest, push = b * turn, moment * speed**2 * turn
        return [
            y[2],
            y[3],
            (push.real - c1 * y[2] - p.k1_N_per_m * (y[0] - rest.real)) / mass,
            (push.imag - c2 * y[3] - p.k2_N_per_m * (y[1] - rest.imag)) / mass,
        ]

    return solve_ivp(right, times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-15).y.T


def test_the_locked_motion_is_that_of_its_equation() -> None:
    p = rig(**BOW)
    times = np.linspace(0.0, 1.0, 21)
    start = np.array([1e-3, -5e-4, 0.0, math.pi, 0.02, 0.03, 0.0, 0.0])
    scene = Scene(SpeedHistory.constant(40.0), (False, False), start)
    found = simulate(p, scene, times, 1e-9).state
    expected = by_hand(p, 40.0, start[[0, 1, 4, 5]], times)
    assert found[:, [0, 1]] == pytest.approx(expected[:, :2], abs=1e-9)


@pytest.mark.parametrize("speed", [5.0, 40.0, 100.0])
def test_the_locked_orbit_repeats(speed: float) -> None:
    p = rig(mass_b=0.06, **BOW)
    x, y = locked_orbit(p, speed)
    start = np.array([x.real, y.imag, (1j * speed * x).real, (1j * speed * y).imag])
    end = by_hand(p, speed, start, np.array([0.0, 2 * math.pi / speed]))[-1]
    assert end == pytest.approx(start, abs=1e-8 * abs(x) * speed)


def test_slowly_rolled_it_shows_the_bow() -> None:
    x, y = locked_orbit(rig(**BOW), 1e-3)
    assert x == pytest.approx(complex(*BOW.values()), rel=1e-4)
    assert y == pytest.approx(complex(*BOW.values()), rel=1e-4)


def test_derivatives_of_the_locked_orbit_are_its_own() -> None:
    p = rig(**BOW)
    for name, slope in locked_state_derivatives(p, 40.0, 0.3, 0.0, math.pi).items():
        step = 1e-5 * p.identified()[name]
        pair = [p.with_values(**{name: p.identified()[name] + sign * step}) for sign in (1, -1)]
        more, less = (locked_state(each, 40.0, 0.3, 0.0, math.pi) for each in pair)
        assert slope == pytest.approx((more - less) / (2 * step), rel=1e-4, abs=1e-9 * np.abs(slope).max() + 1e-15)


def test_on_an_isotropic_suspension_the_pendulums_balance_it_too() -> None:
    p = rig(stiffness_ratio=1.0, **BOW)
    speed = p.speed_rad_s(2.0)
    found = [s for s in steady_states(p, speed, 1e-6) if s.type == "I"]
    assert len(found) == 2
    for state in found:
        assert state.amplitude_m < 1e-9
        moments = (p.a.first_moment_kg_m, p.b.first_moment_kg_m)
        pendulums = sum(s * np.exp(1j * theta) for s, theta in zip(moments, state.theta_rad, strict=True))
        drive = p.imbalance_moment_kg_m + p.k1_N_per_m * p.bow_m / speed**2
        assert abs(pendulums + drive) < 1e-6 * abs(drive)
        assert bow_moment(p, speed) == pytest.approx(p.k1_N_per_m * p.bow_m / speed**2)


@pytest.mark.parametrize("ratio", [1.6, 2.6, 5.8])
def test_every_steady_motion_repeats(ratio: float) -> None:
    p = rig(stiffness_ratio=3.0, **BOW)
    speed = p.speed_rad_s(ratio)
    states = steady_states(p, speed, 1e-6)
    assert not states.unresolved
    assert any(s.stable for s in states)
    straight = [s.theta_rad for s in steady_states(rig(stiffness_ratio=3.0), speed, 1e-6) if s.stable]
    for state in states:
        if state.stable:
            scene = Scene(SpeedHistory.constant(speed), start=state.start)
            end = simulate(p, scene, np.array([0.0, 2 * math.pi / speed]), 1e-8).state[-1]
            assert end[:4] == pytest.approx(state.start[:4], abs=1e-6)
            assert all(np.max(np.abs(np.subtract(state.theta_rad, other))) > 1e-4 for other in straight)


def test_no_bow_beyond_numbers() -> None:
    with pytest.raises(OutsideDomain, match="bow_y_m"):
        rig(bow_y_m=math.nan)
