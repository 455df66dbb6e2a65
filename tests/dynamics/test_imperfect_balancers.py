"""Shifted pivots and mirrored positions against closed forms, steady_states and an integration of their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from dynamics import steady_states
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.steady.mirrored_positions import Imperfections, mirrored_positions
from dynamics.steady.pivot_shift import shifted_pivot
from tests.dynamics.nominal import rig

_P = rig(1.0, 0.05, sp=0.0036)
_SPEED = _P.speed_rad_s(2.5)


def test_one_shift_for_both_leaves_itself_in_both_positions() -> None:
    shift = 1e-4
    both = mirrored_positions(_P, _SPEED, Imperfections(shift, shift))
    known = [s for s in steady_states(replace(_P, pivot_shift_m=shift), _SPEED) if s.type == "I"]
    for position, state in zip(
        sorted(both, key=lambda b: b.theta_rad), sorted(known, key=lambda s: s.theta_rad), strict=True
    ):
        assert position.theta_rad == pytest.approx(state.theta_rad, abs=1e-9)
    assert [abs(p.z_m) for p in both] == pytest.approx([shift, shift], rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.floats(-2e-4, 2e-4), st.floats(-2e-4, 2e-4), st.floats(0.04, 0.1))
def test_one_shift_in_any_direction_and_any_masses_leave_the_same_in_both(x: float, y: float, mass_b: float) -> None:
    p = rig(1.0, 0.05, sp=0.0036, mass_b=mass_b)
    first, second = mirrored_positions(p, _SPEED, Imperfections(complex(x, y), complex(x, y)))
    assert abs(first.z_m) == pytest.approx(abs(second.z_m), abs=1e-12)
    assert abs(first.z_m) == pytest.approx(abs(complex(x, y)), abs=1e-12)


def test_pivots_of_their_own_leave_different_whirls_as_integrated() -> None:
    imperfect = Imperfections(5e-5 + 4e-5j, -3e-5j, 2e-6, -1e-6)
    first, second = mirrored_positions(_P, _SPEED, imperfect)
    assert abs(abs(first.z_m) - abs(second.z_m)) > 1e-5
    for position in (first, second):
        z, theta = _integrated(position.theta_rad, imperfect)
        assert z == pytest.approx(position.z_m, abs=1e-9)
        assert theta == pytest.approx(position.theta_rad, abs=1e-5)


def _integrated(theta: tuple[float, float], imperfect: Imperfections) -> tuple[complex, list[float]]:
    """The equations of motion with two pivots, space-fixed, from the mass matrix; ends after the transient."""
    s = np.array([_P.a.first_moment_kg_m, _P.b.first_moment_kg_m])
    j = np.array([_P.a.inertia_kg_m2, _P.b.inertia_kg_m2])
    pivots = np.array([imperfect.pivot_a_m, imperfect.pivot_b_m])
    torque = np.array([imperfect.torque_a_Nm, imperfect.torque_b_Nm])
    mass, k, c = _P.total_mass_kg, _P.k1_N_per_m, _P.damping_Ns_per_m[0]
    damping = _P.a.damping_Nms_per_rad

    def rates(t: float, u: np.ndarray) -> np.ndarray:
        turn = np.exp(1j * _SPEED * t)
        phi, rate = u[2:4], u[6:8]
        matrix = np.diag([mass, mass, *j]).astype(float)
        matrix[0, 2:] = matrix[2:, 0] = -s * np.sin(phi)
        matrix[1, 2:] = matrix[2:, 1] = s * np.cos(phi)
        pull = np.sum(s * rate**2 * np.exp(1j * phi)) + _P.imbalance_moment_kg_m * _SPEED**2 * turn
        own = -(_SPEED**2) * pivots * turn  # acceleration of the pivots about the disk's centre
        moment = s * (own.real * np.sin(phi) - own.imag * np.cos(phi)) - damping * (rate - _SPEED) + torque
        force = [pull.real - k * u[0] - c * u[4], pull.imag - k * u[1] - c * u[5], *moment]
        return np.concatenate([u[4:], np.linalg.solve(matrix, force)])

    end = 40.0
    start = np.array([0, 0, *theta, 0, 0, _SPEED, _SPEED])
    u = solve_ivp(rates, (0, end), start, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    phase = _SPEED * end
    return complex(u[0], u[1]) * np.exp(-1j * phase), ((u[2:4] - phase) % (2 * math.pi)).tolist()


@pytest.mark.parametrize(
    ("p", "message"),
    [
        (rig(2.0), "isotropic"),
        (replace(_P, pivot_shift_m=1e-4), "pivot shift"),
        (replace(_P, gravity_m_per_s2=9.81), "gravity"),
    ],
)
def test_mirrored_positions_refuse_another_rig(p, message: str) -> None:
    with pytest.raises(OutsideDomain, match=message):
        mirrored_positions(p, _SPEED, Imperfections())


def test_mirrored_positions_refuse_invalid_cases() -> None:
    with pytest.raises(NoBalancedState):
        mirrored_positions(rig(1.0, sp=0.02), _SPEED, Imperfections())
    with pytest.raises(OutsideDomain, match="finite"):
        mirrored_positions(_P, _SPEED, Imperfections(math.nan))
    with pytest.raises(NotConverged, match="lost"):
        mirrored_positions(_P, _SPEED, Imperfections(torque_a_Nm=1.0))


def test_alpha_is_the_shift_until_the_pendulums_meet() -> None:
    p = rig(1.0, 0.02, sp=0.0081 * 0.995)
    found = shifted_pivot(p, p.speed_rad_s(20.0), np.linspace(0, 3, 31))
    shift, alpha = found.ratio
    below = shift < found.together
    gain = math.sqrt((1 / 400 - 1) ** 2 + (2 * 0.02 / 20) ** 2)  # e over the locked amplitude
    assert alpha[below] == pytest.approx(gain * shift[below], rel=1e-9)
    assert found.together == pytest.approx((1 + 1 / 0.995) / (1 - 1 / 400), abs=1e-4)
    assert found.most_apart == pytest.approx(1 / (1 - 1 / 400), abs=2e-4)
    assert np.ptp(alpha[~below]) < 1e-3
    assert np.degrees(found.apart_rad[[0, -1]]) == pytest.approx([2 * math.degrees(math.acos(0.995)), 0], abs=1e-6)


def test_another_eccentricity_only_scales_the_shift() -> None:
    p = rig(1.0, 0.02, sp=0.0081 * 0.995)
    e = p.imbalance_moment_kg_m / (p.rotor_mass_kg + p.imbalance_mass_kg)
    speed = p.speed_rad_s(20.0)
    own, printed = (shifted_pivot(p, speed, np.linspace(0, 3, 31), of) for of in (None, e))
    assert printed.together / own.together == pytest.approx(7.12 / 7.27, rel=1e-5)


def test_shifted_pivot_refuses_invalid_cases() -> None:
    with pytest.raises(OutsideDomain, match="eccentricity"):
        shifted_pivot(rig(1.0, sp=0.0), _SPEED, [0, 1])
    with pytest.raises(OutsideDomain, match="0 or more"):
        shifted_pivot(_P, _SPEED, [-1, 1])
