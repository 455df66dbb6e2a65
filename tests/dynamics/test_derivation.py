"""The compiled kernel, held against the equations of motion derived from energies."""

from __future__ import annotations

import dataclasses
import math

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings, strategies as st

from dynamics import Pendulum, RotorParameters
from dynamics.derivation import (
    ISOTROPIC,
    lagrange_equations,
    rotating_frame_equations,
    singular_point_equations,
    singular_point_matrices,
    symbols as s,
)
from dynamics.derivation.lagrange import energies
from dynamics.derivation.scenes import compiled, moving_rows, rig_values, scene_arguments
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.kernels import FA, jacobian, rates
from dynamics.steady.singular_points import singular_points
from tests.effort import cases

BOTH = (True, True)
SCENES = {
    "both free": (BOTH, {}),
    "A locked": ((False, True), {}),
    "B locked": ((True, False), {}),
    "both locked": ((False, False), {}),
    "no B": (BOTH, {"absent": "b"}),
    "no pendulums": (BOTH, {"absent": "ab"}),
    "balls": (BOTH, {"balls": True}),
    "one ball locked": ((True, False), {"balls": True}),
    "dry friction": (BOTH, {"friction": True}),
    "gravity": (BOTH, {"gravity_m_per_s2": 9.81}),
    "shift compensated": (BOTH, {"pivot_shift_m": 2e-3}),
    "shift not compensated": (BOTH, {"pivot_shift_m": 2e-3, "pivot_shift_compensated": False}),
    "everything": (
        BOTH,
        {
            "balls": True,
            "friction": True,
            "gravity_m_per_s2": 9.81,
            "pivot_shift_m": 3e-3,
            "pivot_shift_compensated": False,
        },
    ),
}
# a gap between rounding (some 1e-15 of the terms) and any error of the equations
TOLERANCE = 1e-12


def random_rig(rng: np.random.Generator, options: dict) -> RotorParameters:
    rest = dict(options)
    absent, balls, friction = rest.pop("absent", ""), rest.pop("balls", False), rest.pop("friction", False)

    def pendulum(name: str) -> Pendulum:
        mass, length, damping = rng.uniform([0.01, 0.02, 0], [0.5, 0.2, 0.1])
        radius = length * rng.uniform(0.05, 0.4) if balls else 0.0
        kappa = rng.uniform(0.3, 0.5)
        arm = length * rng.uniform(0, 0.1) if friction else 0.0
        return Pendulum.absent() if name in absent else Pendulum(mass, length, damping, arm, radius, kappa)

    return RotorParameters(
        *rng.uniform([1, 0.01, 0.001], [10, 0.5, 0.1]),
        pendulum("a"),
        pendulum("b"),
        *rng.uniform([100, 100, 0, 0], [1e5, 1e5, 1, 1]),
        **rest,
    )


def random_motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """State (8,) and ψ, ω, α; the rotor accelerates."""
    return rng.normal(size=8) * [0.01, 0.01, 3, 3, 0.5, 0.5, 20, 20], rng.normal(size=3) * [3, 60, 20]


def packed(p: RotorParameters, state: np.ndarray) -> np.ndarray:
    """The kernel's numbers with the friction coefficients signed as the pendulums slide."""
    numbers = p.packed()
    numbers[FA : FA + 2] *= np.where(state[6:8] >= 0, 1, -1)
    return numbers


def derived(
    state: np.ndarray, phase: np.ndarray, p: RotorParameters, released: tuple[bool, bool]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Accelerations (4,), the size of their terms (4,), their derivatives by the state (4, 8), and the moving rows.

    Computed with 40 digits, so only the kernel rounds.
    """
    rows = moving_rows(p, released)
    function = compiled(lagrange_equations)
    moving, rest = scene_arguments(state, phase, p, released)
    with mpmath.workdps(40):
        mass, right, sizes, *_ = function(*map(mpmath.mpf, (*moving, 0, 0, 0, 0, *rest)))
        inverse = mpmath.matrix([[mass[i, j] for j in rows] for i in rows]) ** -1
        solved = inverse * mpmath.matrix([right[i] for i in rows])
        spread = inverse.apply(abs) * mpmath.matrix([sizes[i] for i in rows])
        accelerations, size = [mpmath.mpf(0)] * 4, [mpmath.mpf(0)] * 4
        for n, row in enumerate(rows):
            accelerations[row], size[row] = solved[n], spread[n]
        # ∂a/∂y = −M⁻¹ ∂(M a − right)/∂y, with the accelerations just found
        *_, stiffness, damping = function(*map(mpmath.mpf, moving), *accelerations, *map(mpmath.mpf, rest))
        slopes = np.zeros((4, 8))
        for block, matrix in ((0, stiffness), (4, damping)):
            columns = [*range(4)] if block == 0 else rows
            moved = -inverse * mpmath.matrix([[matrix[i, j] for j in columns] for i in rows])
            slopes[np.ix_(rows, [block + j for j in columns])] = np.array(moved.tolist(), float)
    return np.array(accelerations, float), np.array(size, float), slopes, rows


@pytest.mark.parametrize("scene", SCENES)
@settings(max_examples=cases(10, 40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_kernel_equals_the_derivation(scene: str, seed: int) -> None:
    released, options = SCENES[scene]
    rng = np.random.default_rng(seed)
    p = random_rig(rng, options)
    state, phase = random_motion(rng)
    state[6:8] *= (p.a.present, p.b.present)
    expected, size, slopes, rows = derived(state, phase, p, released)
    free = [float(f) for f in released]
    out, tangent = np.empty(8), np.empty((8, 8))
    rates(state, *phase, packed(p, state), *free, out)
    assert np.array_equal(out[:4], state[4:8] * [1, 1, *free])
    assert np.all(np.abs(out[4:] - expected) <= TOLERANCE * size)
    assert all(out[4 + i] == 0 for i in (2, 3) if i not in rows)
    jacobian(state, *phase, packed(p, state), *free, tangent)
    largest = np.max(np.abs(slopes), axis=1, keepdims=True) + size[:, None]
    assert np.all(np.abs(tangent[4:] - slopes) <= TOLERANCE * largest)
    assert np.array_equal(tangent[:4], np.hstack([np.zeros((4, 4)), np.diag([1, 1, *free])]))


@settings(max_examples=cases(8, 20), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_both_frames_give_one_motion(seed: int) -> None:
    """x + i y = z e^{iψ}: derived apart in each frame, the accelerations agree to 30 digits."""
    rng = np.random.default_rng(seed)
    p = random_rig(rng, SCENES["everything"][1])
    state, phase = random_motion(rng)
    moving, rest = scene_arguments(state, phase, p, BOTH)
    with mpmath.workdps(40):
        mass, right, *_ = compiled(lagrange_equations)(*map(mpmath.mpf, (*moving, 0, 0, 0, 0, *rest)))
        resting = mpmath.lu_solve(mass, right)
        psi, omega, alpha = map(mpmath.mpf, phase)
        back = mpmath.expj(-psi)
        z = mpmath.mpc(*state[:2]) * back
        dz = mpmath.mpc(*state[4:6]) * back - 1j * omega * z
        turned = (z.real, z.imag, *state[2:4], dz.real, dz.imag, *state[6:8], 0, 0, 0, 0)
        mass, right, *_ = compiled(rotating_frame_equations)(*map(mpmath.mpf, (*turned, *rest)))
        turning = mpmath.lu_solve(mass, right)
        ddz = mpmath.mpc(turning[0], turning[1])
        seen = (ddz + 2j * omega * dz + (1j * alpha - omega**2) * z) / back
        size = max(abs(a) for a in resting) + 1
        assert abs(seen - mpmath.mpc(resting[0], resting[1])) < size * mpmath.mpf(10) ** -30
        assert max(abs(turning[i] - resting[i]) for i in (2, 3)) < size * mpmath.mpf(10) ** -30


def numbers(matrix: sp.Matrix, values: dict) -> np.ndarray:
    return np.array(matrix.subs(values).evalf(20), float)


def turning_matrix(
    p: RotorParameters, psi: float, omega: float, y1: float, y2: float, t3: float, t4: float
) -> np.ndarray:
    """[A] of the linear motion in the turning frame from the derivation, shape (8, 8)."""
    values = rig_values(p)
    moments = {
        s.M_S: p.total_mass_kg,
        s.S_A: p.a.first_moment_kg_m,
        s.S_B: p.b.first_moment_kg_m,
        s.S_P: p.imbalance_moment_kg_m,
        s.psi: psi,
        s.omega: omega,
        s.Y1: y1,
        s.Y2: y2,
        s.theta3: t3,
        s.theta4: t4,
    }
    linear = singular_point_matrices()
    inertia, damping, stiffness = (
        numbers(m, values | moments) for m in (linear.inertia, linear.damping, linear.stiffness)
    )
    lower = -np.linalg.solve(inertia, np.hstack([stiffness, damping]))
    return np.vstack([np.hstack([np.zeros((4, 4)), np.eye(4)]), lower])


def seen_from_the_rotor(p: RotorParameters, psi: float, omega: float, state: np.ndarray) -> np.ndarray:
    """The kernel's Jacobian in turning coordinates: w = T y, so ẇ = (T A + Ṫ) T⁻¹ w, shape (8, 8)."""
    tangent = np.empty((8, 8))
    jacobian(state, psi, omega, 0.0, p.packed(), 1.0, 1.0, tangent)
    c, d = math.cos(psi), math.sin(psi)
    turn, rate = np.array([[c, d], [-d, c]]), omega * np.array([[-d, c], [-c, -d]])
    T, T_dot = np.eye(8), np.zeros((8, 8))
    T[:2, :2] = T[4:6, 4:6] = turn
    T[4:6, :2] = rate
    T_dot[:2, :2] = T_dot[4:6, 4:6] = rate
    T_dot[4:6, :2] = -(omega**2) * turn
    return (T @ tangent + T_dot) @ np.linalg.inv(T)


NOMINAL = RotorParameters(
    7.0, 0.12, 0.02117, Pendulum(0.075, 0.054, 0.001), Pendulum(0.055, 0.054, 0.002), 2583.0, 14.9 * 2583.0, 0.02, 0.05
)


@pytest.mark.parametrize("psi", [0.0, 0.4, 2.0])
def test_type_i_matrices_equal_the_kernels_jacobian(psi: float) -> None:
    t3, t4 = balanced_angles(NOMINAL)[0]
    state = np.zeros(8)
    state[2:4] = t3, t4
    expected = seen_from_the_rotor(NOMINAL, psi, 30.0, state)
    found = turning_matrix(NOMINAL, psi, 30.0, 0, 0, t3, t4)
    assert np.allclose(found, expected, rtol=1e-11, atol=1e-11 * np.max(np.abs(expected)))


@pytest.mark.parametrize("kind", ["II", "III"])
def test_isotropic_matrices_hold_where_the_disk_whirls(kind: str) -> None:
    """Types II and III rest in the turning frame at Y1, Y2, which [K + N] holds."""
    p = dataclasses.replace(NOMINAL, k2_N_per_m=NOMINAL.k1_N_per_m, zeta2=NOMINAL.zeta1)
    omega = 30.0
    point = next(point for point in singular_points(p, omega) if point.type == kind)
    (t3, t4), z = point.theta_rad, point.z_m
    values = rig_values(p) | {
        s.M_S: p.total_mass_kg,
        s.S_A: p.a.first_moment_kg_m,
        s.S_B: p.b.first_moment_kg_m,
        s.S_P: p.imbalance_moment_kg_m,
        s.psi: 0.3,
        s.omega: omega,
        s.Y1: z.real,
        s.Y2: z.imag,
        s.theta3: t3,
        s.theta4: t4,
    }
    rest = numbers(singular_point_equations(), values)
    assert np.max(np.abs(rest)) < 1e-12 * p.k1_N_per_m * abs(z)
    psi, turn = 0.3, np.exp(0.3j)
    q, dq = z * turn, 1j * omega * z * turn
    state = np.array([q.real, q.imag, t3, t4, dq.real, dq.imag, 0, 0])
    expected = seen_from_the_rotor(p, psi, omega, state)
    found = turning_matrix(p, psi, omega, z.real, z.imag, t3, t4)
    assert np.allclose(found, expected, rtol=1e-11, atol=1e-11 * np.max(np.abs(expected)))


def test_general_properties_of_the_derivation() -> None:
    """Symmetric mass matrix; ψ leaves the isotropic matrices; half a revolution is a period of the others."""
    equations = rotating_frame_equations()
    assert equations.mass_matrix == equations.mass_matrix.T
    assert not any(m.has(s.psi) for m in dataclasses.astuple(singular_point_matrices().subs(ISOTROPIC)))
    damping, stiffness = singular_point_matrices().damping, singular_point_matrices().stiffness
    assert damping.has(s.psi)
    for matrix in (damping, stiffness):
        later = matrix.subs(s.psi, s.psi + sp.pi).applyfunc(s.normal_form)
        assert (later - matrix).applyfunc(s.normal_form) == sp.zeros(4, 4)


def test_friction_takes_energy_and_compensation_adds_no_mass() -> None:
    """The friction torque times θ̇ is a loss, and brass weights change no mass matrix."""
    for torque, rate, sign in zip(energies().forces[2:], (s.dtheta3, s.dtheta4), (s.sign_A, s.sign_B), strict=True):
        ones = dict.fromkeys(s.RIG, 1) | {s.omega: -3}
        assert torque.subs(sign, 1).subs(ones | {rate: 2}) < 0 < torque.subs(sign, -1).subs(ones | {rate: -2})
    assert not lagrange_equations().mass_matrix.has(s.compensated)
    pull = lagrange_equations().right_side.subs({s.alpha: 0, s.psi: 0})[0].diff(s.R_C)
    expected = (s.M_A + s.M_B) * s.omega**2 * (1 - s.compensated)
    assert s.normal_form(pull - expected) == 0
