"""Eigenvalues of singular points against the multipliers, and against a pendulum known by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dynamics import Pendulum, steady_states
from dynamics.errors import OutsideDomain
from dynamics.steady.point_eigenvalues import point_eigenvalues, stability_of
from dynamics.steady.singular_points import singular_points
from tests.dynamics.nominal import rig


@pytest.mark.parametrize("ratio", [0.6, 2.5])
def test_they_are_the_logarithms_of_the_multipliers(ratio: float) -> None:
    p = rig(1.0, zeta=0.05, mass_b=0.04, sp=0.003)
    speed = p.speed_rad_s(ratio)
    points = singular_points(p, speed)
    values = point_eigenvalues(p, speed, points)
    states = steady_states(p, speed)
    assert len(states) == len(points)
    for point, own in zip(points, values, strict=True):
        state = next(
            s
            for s in states
            if np.allclose(np.exp(1j * np.array(s.theta_rad)), np.exp(1j * np.array(point.theta_rad)), atol=1e-9)
        )
        assert np.all(np.diff(own.real) <= 0), "the largest real part first"
        expected = np.exp(2 * math.pi * own / speed)
        assert np.sort(np.abs(expected)) == pytest.approx(np.sort(np.abs(state.multipliers)), rel=1e-6, abs=1e-9)
        assert (stability_of(own) == 1) == state.stable


def test_pendulums_too_light_to_move_the_rotor_swing_by_themselves() -> None:
    p = rig(1.0, zeta=0.3)
    light = Pendulum(1e-9, 0.054, 2e-12)
    p = replace(p, a=light, b=light)
    speed = p.speed_rad_s(0.7)
    points = [point for point in singular_points(p, speed) if point.type == "III"]
    values = point_eigenvalues(p, speed, points)
    rate, inertia = light.damping_Nms_per_rad, light.inertia_kg_m2
    for point, own in zip(points, values, strict=True):
        outward = (point.z_m * np.exp(-1j * point.theta_rad[0])).real
        swing = np.roots([inertia, rate, light.first_moment_kg_m * speed**2 * outward])
        for root in swing:
            assert np.min(np.abs(own - root)) < 1e-3 * abs(root)


def test_rounding_is_neither_stable_nor_unstable() -> None:
    values = np.array([[1e-15, -1.0], [1e-3, -1.0], [-1e-3, -1.0]], np.complex128)
    assert stability_of(values).tolist() == [0, -1, 1]


def test_refusals() -> None:
    with pytest.raises(OutsideDomain, match="both pendulums"):
        point_eigenvalues(replace(rig(1.0), b=Pendulum.absent()), 10.0, [])
    with pytest.raises(OutsideDomain, match="finite value above 0"):
        point_eigenvalues(rig(1.0), 0.0, [])
    p = rig()
    points = singular_points(p, p.speed_rad_s(2.0))
    with pytest.raises(OutsideDomain, match="constant equations only"):
        point_eigenvalues(p, p.speed_rad_s(2.0), points)
