"""The compiled equations against closed forms and published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics import (
    Pendulum,
    RotorParameters,
    Scene,
    SpeedHistory,
    locked_orbit,
    multipliers,
    simulate,
    steady_states,
)
from dynamics.errors import OutsideDomain
from dynamics.integrate import locked_state
from dynamics.steady_motions import balanced_angles


def rig(
    stiffness_ratio: float = 14.9, zeta: float = 0.02, sp: float = 0.12 * 0.02117, mass_b: float = 0.075
) -> RotorParameters:
    mass = 7.0 + 0.12 + 0.075 + mass_b
    k1 = mass * (2 * math.pi * 3) ** 2
    return RotorParameters(
        7.0, 0.12, sp / 0.12, Pendulum(0.075, 0.054, 0.001), Pendulum(mass_b, 0.054, 0.001), k1, stiffness_ratio * k1,
        zeta, zeta,
    )  # fmt: skip


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


@pytest.mark.parametrize(
    ("ratio", "expected"), [(0.83, 1.361992), (1.6, 0.937055), (2.6, 0.974796), (3.3, 1.373347), (5.8, 0.978556)]
)
def test_multipliers_of_the_balanced_state(ratio: float, expected: float) -> None:
    """Six digits of an independent model in double precision."""
    p = rig()
    state = multipliers(p, p.speed_rad_s(ratio), 1e-9)
    assert state.multiplier_max == pytest.approx(expected, abs=6e-7)
    assert state.error_estimate < 1e-8


@pytest.mark.parametrize(
    ("p", "ratio", "kind", "angle_deg", "amplitude_mm"),
    [
        (rig(1.0, 0.05), 0.8, "III", 303.708, 2.325497),
        (rig(1.0, 0.05, 0.012), 2.5, "III", 180.886, 0.638397),
        (rig(1.0, 0.05, 0.001, 0.019), 2.5, "II", 174.456, 0.334778),
    ],
)
def test_isotropic_steady_states(
    p: RotorParameters, ratio: float, kind: str, angle_deg: float, amplitude_mm: float
) -> None:
    stable = [s for s in steady_states(p, p.speed_rad_s(ratio)) if s.stable]
    assert [s.type for s in stable] == [kind]
    assert math.degrees(stable[0].theta_rad[0]) == pytest.approx(angle_deg, abs=6e-4)
    assert 1e3 * stable[0].amplitude_m == pytest.approx(amplitude_mm, abs=6e-7)


@pytest.mark.parametrize(("ratio", "kind"), [(0.83, "III"), (3.3, "III"), (5.8, "I")])
def test_a_released_rig_ends_in_the_predicted_state(ratio: float, kind: str) -> None:
    p = rig()
    speed = p.speed_rad_s(ratio)
    start = locked_state(p, speed, 0.0, 2e-3, math.pi - 1e-3)
    times = np.linspace(0, 100 * 2 * np.pi / speed * 10, 20001)
    motion = simulate(p, Scene(SpeedHistory.constant(speed), start=start), times, 1e-4)
    ends = motion.angles_rad[-2001:].mean(axis=0)
    stable = [s for s in steady_states(p, speed) if s.stable and s.type == kind]
    nearest = min(np.max(np.abs(np.exp(1j * ends) - np.exp(1j * np.array(s.theta_rad)))) for s in stable)
    assert nearest < 5e-3


@given(st.floats(0.01, 1), st.floats(0.01, 1), st.floats(0.001, 2.5))
def test_balanced_angles_balance(mass_a: float, mass_b: float, share: float) -> None:
    a, b = Pendulum(mass_a, 0.05, 1e-3), Pendulum(mass_b, 0.05, 1e-3)
    moment = share * (a.first_moment_kg_m + b.first_moment_kg_m)
    p = RotorParameters(7.0, 1.0, moment, a, b, 2000.0, 3000.0, 0.02, 0.02)
    found = balanced_angles(p)
    exists = abs(a.first_moment_kg_m - b.first_moment_kg_m) <= moment <= a.first_moment_kg_m + b.first_moment_kg_m
    assert len(found) == (2 if exists else 0)
    for t3, t4 in found:
        rest = a.first_moment_kg_m * np.exp(1j * t3) + b.first_moment_kg_m * np.exp(1j * t4) + moment
        assert abs(rest) < 1e-7 * (mass_a + mass_b)


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
