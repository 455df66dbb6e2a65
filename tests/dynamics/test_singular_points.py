"""Closed-form singular points: the equations they solve, where they are lost, and the pivot shift's counterpart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dynamics import locked_orbit, steady_states
from dynamics.equations.kernels import rates
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import OutsideDomain
from dynamics.steady.singular_points import SingularPoint, aligned_points, dynamic_stiffness, singular_points
from tests.dynamics.nominal import from_domain, rig


def residual(p: RotorParameters, speed: float, point: SingularPoint) -> float:
    """What the compiled equations leave of a circular whirl: relative to the disk's and the pendulums' forces."""
    z, (a, b) = point.z_m, point.theta_rad
    v = 1j * speed * z
    y = np.array([z.real, z.imag, a, b, v.real, v.imag, 0.0, 0.0])
    out = np.empty(8)
    rates(y, 0.0, speed, 0.0, p.packed(), 1.0, 1.0, out)
    wanted = -(speed**2) * z
    size = speed**2 * (abs(z) + p.pivot_shift_m + (p.forcing_moment_kg_m + p.a.first_moment_kg_m) / p.total_mass_kg)
    stiff = max(p.k1_N_per_m, abs(dynamic_stiffness(p, speed))) * abs(z) / p.total_mass_kg
    linear = abs(complex(out[4], out[5]) - wanted) / (size + stiff)
    angular = np.max(np.abs(out[6:])) * p.a.length_m / (size + stiff)
    return max(linear, angular)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 3e-4, 3e-3]))
def test_every_point_satisfies_the_equations_of_motion(seed: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    drawn, ratio = from_domain(rng)
    isotropic = RotorParameters(
        drawn.rotor_mass_kg,
        drawn.imbalance_mass_kg,
        drawn.imbalance_radius_m,
        drawn.a,
        drawn.b,
        drawn.k1_N_per_m,
        drawn.k1_N_per_m,
        drawn.zeta1,
        drawn.zeta1,
        shift,
        bool(seed % 2),
    )
    for point in singular_points(isotropic, isotropic.speed_rad_s(ratio)):
        if np.isfinite(point.z_m):
            assert residual(isotropic, isotropic.speed_rad_s(ratio), point) < 1e-11


@pytest.mark.parametrize(
    ("p", "ratio", "kind", "angle_deg", "amplitude_mm"),
    [
        (rig(1.0, 0.05), 0.8, "III", 303.708, 2.325497),
        (rig(1.0, 0.05, 0.012), 2.5, "III", 180.886, 0.638397),
        (rig(1.0, 0.05, 0.001, 0.019), 2.5, "II", 174.456, 0.334778),
    ],
)
def test_published_figures(p: RotorParameters, ratio: float, kind: str, angle_deg: float, amplitude_mm: float) -> None:
    found = [s for s in singular_points(p, p.speed_rad_s(ratio)) if s.type == kind]
    nearest = min(found, key=lambda s: abs(math.degrees(s.theta_rad[0]) - angle_deg))
    assert math.degrees(nearest.theta_rad[0]) == pytest.approx(angle_deg, abs=6e-4)
    assert 1e3 * abs(nearest.z_m) == pytest.approx(amplitude_mm, abs=6e-7)


def test_a_pair_is_lost_where_damping_asks_for_more_torque_than_the_imbalance_has() -> None:
    """|S_T sin φ_H| > S_P near resonance at high damping; the loss agrees with the formula, to a part in 1e9."""
    p = rig(1.0, 0.2)
    together = p.a.first_moment_kg_m + p.b.first_moment_kg_m

    def sine(ratio: float) -> float:
        stiffness = dynamic_stiffness(p, p.speed_rad_s(ratio))
        return together * math.sin(math.atan2(stiffness.imag, stiffness.real)) / p.imbalance_moment_kg_m

    low, high = 0.5, 1.0
    assert sine(low) < 1 < sine(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if sine(middle) > 1 else (middle, high)
    nearby = [
        aligned_points(dynamic_stiffness(p, p.speed_rad_s(r)), p.speed_rad_s(r), together, p.imbalance_moment_kg_m)
        for r in (low * (1 - 1e-9), low * (1 + 1e-9))
    ]
    assert [len(x) for x in nearby] == [2, 0]


def test_pivot_shift_far_above_resonance_turns_the_balanced_pair() -> None:
    """S_A + S_B just S_P: together on the far side at R_C = 0, 180° apart at R_C = e, on the near side at 2e."""
    p0 = rig(1.0, 0.02, sp=2 * 0.075 * 0.054)
    e = p0.imbalance_moment_kg_m / p0.total_mass_kg
    gaps, first = [], []
    for shift in (0.0, e, 2 * e * (1 - 1e-6)):
        p = rig(1.0, 0.02, sp=2 * 0.075 * 0.054, pivot_shift_m=shift)
        # the last term of the target vanishes like 1/ω²
        points = [s for s in singular_points(p, p.speed_rad_s(3e3)) if s.type == "I"]
        angles = np.degrees(points[0].theta_rad)
        gaps.append(abs((angles[0] - angles[1] + 180) % 360 - 180))
        first.append(np.cos(np.radians(angles[0])))
        assert abs(points[0].z_m + shift) < 1e-15
    assert gaps == pytest.approx([0, 180, 0], abs=0.6)
    assert first[0] == pytest.approx(-1, abs=1e-4)
    assert first[2] == pytest.approx(1, abs=1e-4)


def test_nothing_free_is_the_linear_orbit() -> None:
    p = rig(1.0, 0.05)
    speed = p.speed_rad_s(0.7)
    (point,) = singular_points(p, speed, (False, False), (0.3, 0.9))
    moment = p.imbalance_moment_kg_m + p.a.first_moment_kg_m * (np.exp(0.3j) + np.exp(0.9j))
    assert point.type == "none"
    assert point.z_m == pytest.approx(speed**2 * moment / dynamic_stiffness(p, speed), rel=1e-14)


def test_one_free_pendulum_lies_along_the_whirl() -> None:
    p = rig(1.0, 0.05)
    points = singular_points(p, p.speed_rad_s(0.7), (True, False), (0.0, 2.0))
    assert [s.type for s in points] == ["one", "one"]
    for s in points:
        assert s.theta_rad[1] == 2.0
        assert abs((np.conj(s.z_m) * np.exp(1j * s.theta_rad[0])).imag) < 1e-14 * abs(s.z_m)


def test_a_resonance_without_damping_is_named() -> None:
    speed = 16.0  # a power of two: M ω² has no rounding
    p = replace(rig(zeta=0.0), k1_N_per_m=rig().total_mass_kg * speed**2)
    with pytest.raises(OutsideDomain, match="undamped resonance"):
        locked_orbit(p, speed)
    assert {s.type for s in steady_states(p, speed)} >= {"I"}
    assert singular_points(replace(p, k2_N_per_m=p.k1_N_per_m), speed, (False, False)) == []
