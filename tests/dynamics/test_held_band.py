"""Angles at which dry friction holds both pendulums, against the torque that holds them over a revolution."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dynamics.motions.locked_motion import locked_orbit
from dynamics.steady.held_band import held_band
from dynamics.steady.stick_band import stick_half_width
from tests.dynamics.nominal import rig

BALANCED = np.arccos(-0.12 * 0.02117 / (2 * 0.075 * 0.054))


def most_needed(speed: float, theta: np.ndarray) -> np.ndarray:
    """The largest torque over a revolution that holds A and B at rest on the rotor, N m, shape (2,)."""
    p, psi = rig(), np.linspace(0, 2 * np.pi, 721)
    x, y = locked_orbit(p, speed, float(theta[0]), float(theta[1]))
    ax, ay = -(speed**2) * np.real(x * np.exp(1j * psi)), -(speed**2) * np.imag(y * np.exp(1j * psi))
    s = p.a.first_moment_kg_m
    return np.array([np.max(np.abs(s * (np.sin(psi + t) * ax - np.cos(psi + t) * ay))) for t in theta])


@given(st.sampled_from([1.6, 2.6, 5.8]), st.floats(1e-8, 5e-6), st.floats(0.3, 1.0), st.floats(0, 2 * np.pi))
def test_what_is_held_is_held_all_round(ratio: float, torque: float, share: float, along: float) -> None:
    p = rig()
    speed, there = p.speed_rad_s(ratio), np.array([BALANCED, -BALANCED])
    torques = torque * np.array([1.0, share])
    band = held_band(p, speed, (BALANCED, -BALANCED), torques)
    root = np.linalg.cholesky(band.covariance)
    inside = there + 0.2 * root @ [np.cos(along), np.sin(along)]
    far = there + 4.0 * root @ [np.cos(along), np.sin(along)]
    assert np.all(most_needed(speed, inside) < 1.02 * torques)
    assert np.any(most_needed(speed, far) > torques)
    assert np.all(np.sqrt(np.diag(band.covariance)) < 1.1 * band.half_width_rad)


def test_a_creep_ends_within_a_deviation_along_its_direction() -> None:
    p = rig()
    speed = p.speed_rad_s(1.6)
    band = held_band(p, speed, (BALANCED, -BALANCED), np.full(2, 1.2e-5))
    ends = []
    for share in np.linspace(0.2, 2.0, 400):  # along the slowest direction the angles move alike
        at = np.array([BALANCED, -BALANCED]) + share * band.half_width_rad
        if np.all(most_needed(speed, at) <= 1.2e-5):
            ends.append(share * band.half_width_rad)
    end = ends[-1]
    assert end @ np.linalg.solve(band.covariance, end) == pytest.approx(1.0, abs=0.15)


def test_an_isotropic_rig_has_no_pulsation_and_the_whole_outer_band() -> None:
    p = rig()
    p = dataclasses.replace(p, k2_N_per_m=p.k1_N_per_m, zeta2=p.zeta1)
    rough = dataclasses.replace(
        p, a=dataclasses.replace(p.a, friction_arm_m=1e-5), b=dataclasses.replace(p.b, friction_arm_m=1e-5)
    )
    speed = p.speed_rad_s(2.5)
    torque = np.full(2, 1e-5 * p.a.first_moment_kg_m * speed**2)
    band = held_band(p, speed, (BALANCED, -BALANCED), torque)
    assert band.half_width_rad == pytest.approx(stick_half_width(rough, speed, (BALANCED, -BALANCED)), rel=0.03)


def test_a_pulsation_above_the_friction_leaves_nothing() -> None:
    p = rig()
    speed, together = p.speed_rad_s(3.3), (np.pi, np.pi)
    shaken = held_band(p, speed, together, np.full(2, 1e-6))
    assert np.all(shaken.half_width_rad == 0.0)
    assert np.all(shaken.covariance == 0.0)
    held = held_band(p, speed, together, 2 * most_needed(speed, np.array(together)))
    assert np.all(held.half_width_rad > 0.0)


def test_the_orbit_goes_with_the_angles() -> None:
    p = rig()
    speed = p.speed_rad_s(2.6)
    band = held_band(p, speed, (BALANCED, -BALANCED), np.full(2, 1e-5))
    x, y = locked_orbit(p, speed, BALANCED + 1e-4, -BALANCED)
    assert band.orbit_slopes[:, 0] * 1e-4 == pytest.approx(np.array([x, -1j * y]), rel=1e-3)
    drawn = band.orbit_slopes @ np.linalg.cholesky(band.covariance)
    assert band.whirl_variance_m2 == pytest.approx(0.5 * np.sum(np.abs(drawn) ** 2, axis=1))
