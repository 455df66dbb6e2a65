"""Effect of misprinted cells: multipliers and growth rates from printed instead of derived matrices."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import scipy.linalg

from dynamics.arrays import Array, Complex
from dynamics.derivation import source_equations as source, symbols as s
from dynamics.derivation.comparison import comparison
from dynamics.derivation.lagrange import rotating_frame_equations
from dynamics.derivation.linearised import ISOTROPIC, LinearMotion, at_rest, linearised, singular_point_matrices
from dynamics.derivation.scenes import rig_values
from dynamics.derivation.source_listing import CELL_1_4_AS_LISTED
from dynamics.derivation.symbols import sp
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.steady.singular_points import singular_points

_linear_algebra: Any = scipy.linalg  # scipy has no annotations
# Validation points on the line K = 14.9, by speed ratio
POINTS = {"A": 0.83, "B": 1.6, "C": 2.6, "D": 3.3, "E": 5.8}
NOMINAL_MOMENT_KG_M = 0.12 * 0.02117
_ARGUMENTS = (
    s.psi,
    s.omega,
    s.Y1,
    s.Y2,
    s.theta3,
    s.theta4,
    s.M_S,
    s.S_A,
    s.S_B,
    s.S_P,
    *s.RIG,
)


def rig(
    stiffness_ratio: float = 14.9,
    zeta: float = 0.02,
    moment_kg_m: float = NOMINAL_MOMENT_KG_M,
    mass_b_kg: float = 0.075,
    damping: tuple[float, float] = (1e-3, 1e-3),
) -> RotorParameters:
    """Rig with nominal values: M_D 7 kg, M_P 0.12 kg, M_A 0.075 kg, R 54 mm, f_n1 3 Hz.

    Args:
        stiffness_ratio: K = k2/k1.
        zeta: damping ratio of both directions.
        moment_kg_m: S_P, kg m.
        mass_b_kg: mass of pendulum B, kg.
        damping: c3, c4, N m s/rad.
    """
    mass = 7.0 + 0.12 + 0.075 + mass_b_kg
    k1 = mass * (2 * math.pi * 3) ** 2
    a, b = Pendulum(0.075, 0.054, damping[0]), Pendulum(mass_b_kg, 0.054, damping[1])
    return RotorParameters(7.0, 0.12, moment_kg_m / 0.12, a, b, k1, stiffness_ratio * k1, zeta, zeta)


class NumericMotion:
    """Numerical evaluation of a LinearMotion."""

    def __init__(self, linear: LinearMotion) -> None:
        matrices = [linear.inertia, linear.damping, linear.stiffness]
        self._evaluate: Callable[..., Any] = sp.lambdify(_ARGUMENTS, matrices, "numpy", cse=True)

    def system(self, p: RotorParameters, psi: float, omega: float, state: Sequence[float]) -> Array:
        """[A] of the first-order system, shape (8, 8).

        Args:
            p: the rig.
            psi, omega: rotor phase (rad) and speed (rad/s).
            state: Y1, Y2 (m), θ3, θ4 (rad).
        """
        moments = p.total_mass_kg, p.a.first_moment_kg_m, p.b.first_moment_kg_m, p.imbalance_moment_kg_m
        inertia, damping, stiffness = self._evaluate(psi, omega, *state, *moments, *rig_values(p).values())
        lower = -np.linalg.solve(np.array(inertia, float), np.hstack([stiffness, damping]).astype(float))
        return np.vstack([np.hstack([np.zeros((4, 4)), np.eye(4)]), lower])

    def matrices(
        self, p: RotorParameters, psi: float, omega: float, state: Sequence[float], moments: Sequence[float]
    ) -> list[Array]:
        """[M], [D + G], [K + N], shape (4, 4) each. Arguments as for `system`; moments are M_S, S_A, S_B, S_P."""
        found = self._evaluate(psi, omega, *state, *moments, *rig_values(p).values())
        return [np.array(matrix, float) for matrix in found]

    def type_i_harmonics(self, p: RotorParameters, omega: float) -> Array:
        """[A] = [A0] + [A1] cos 2ψ + [A2] sin 2ψ about Type I, shape (3, 8, 8). There are no other harmonics."""
        state = (0.0, 0.0, *balanced_angles(p)[0])
        start, eighth, quarter = (self.system(p, psi, omega, state) for psi in (0.0, math.pi / 4, math.pi / 2))
        mean = (start + quarter) / 2
        return np.array([mean, start - mean, eighth - mean])

    def multipliers(self, p: RotorParameters, speed_ratios: Iterable[float], steps: int = 400) -> Array:
        """Largest modulus of the Type I multipliers over one revolution, shape (n,)."""
        return np.max(np.abs(self.spectra(p, speed_ratios, steps)), axis=-1)

    def spectra(self, p: RotorParameters, speed_ratios: Iterable[float], steps: int = 400) -> Complex:
        """All Type I multipliers over one revolution, complex, shape (n, 8).

        Classical Runge–Kutta over half a revolution, for all speeds at once. With 400 steps the error is about 1e-8 at
        the points.
        """
        omegas = np.array([p.speed_rad_s(ratio) for ratio in speed_ratios])
        harmonics = (
            np.array([self.type_i_harmonics(p, w) for w in omegas]) * (np.pi / steps / omegas)[:, None, None, None]
        )
        halves = np.array(
            [_at(harmonics, math.pi * n / (2 * steps)) for n in range(2 * steps + 1)]
        )  # h [A] at every half step
        motion = np.broadcast_to(np.eye(8), (len(omegas), 8, 8))
        for n in range(steps):
            before, middle, after = halves[2 * n], halves[2 * n + 1], halves[2 * n + 2]
            first = before @ motion
            second = middle @ (motion + first / 2)
            third = middle @ (motion + second / 2)
            motion = motion + (first + 2 * second + 2 * third + after @ (motion + third)) / 6
        return np.asarray(np.linalg.eigvals(motion) ** 2, np.complex128)

    def piecewise_multiplier(self, p: RotorParameters, ratio: float, pieces: int, shift: float) -> float:
        """Largest multiplier by the source's piecewise scheme over one revolution: [A] is constant on each piece.

        Args:
            shift: sampling position of [A] as a fraction of the piece: 0.5 middle (text), 1 end (listing).
        """
        omega = p.speed_rad_s(ratio)
        harmonics = self.type_i_harmonics(p, omega)
        samples = np.array([_at(harmonics, 2 * math.pi * (n + shift) / pieces) for n in range(pieces)])
        motion = np.eye(8)
        for piece in _linear_algebra.expm(samples * (2 * math.pi / omega / pieces)):
            motion = piece @ motion
        return float(np.max(np.abs(np.linalg.eigvals(motion))))

    def growth_rate(self, p: RotorParameters, omega: float, state: Sequence[float]) -> float:
        """Largest real part of the eigenvalues about a state at rest in the rotating frame, 1/s (isotropic rig)."""
        return float(np.max(np.linalg.eigvals(self.system(p, 0.0, omega, state)).real))


def _at(harmonics: Array, psi: float) -> Array:
    return (
        harmonics[..., 0, :, :]
        + math.cos(2 * psi) * harmonics[..., 1, :, :]
        + math.sin(2 * psi) * harmonics[..., 2, :, :]
    )


def _with_printed(numbers: dict[str, tuple[tuple[int, int], ...] | None], isotropic: bool = False) -> LinearMotion:
    """Derived matrices in which printed cells replace derived ones.

    Args:
        numbers: equation numbers with their printed cells (row, column from 1). None: all cells that differ.
    """
    right = singular_point_matrices().subs(ISOTROPIC) if isotropic else singular_point_matrices()
    matrices = {"inertia": right.inertia.copy(), "damping": right.damping.copy(), "stiffness": right.stiffness.copy()}
    for number, cells in numbers.items():
        target = matrices[{27: "inertia", 28: "damping", 29: "stiffness"}[(int(number[2:]) - 15) % 12 + 27]]
        for d in comparison(number).deviations:
            if cells is None or (d.row, d.column) in cells:
                target[d.row - 1, d.column - 1] = d.printed
    return LinearMotion(**{name: sp.Matrix(m) for name, m in matrices.items()})


def printed_motion(first: bool, second: bool) -> LinearMotion:
    """Linearisation about a state at rest with (4-6) and/or (4-7) as printed, the other equations as derived."""
    equations = rotating_frame_equations()
    rows = list(equations.residual.subs(s.PLAIN).applyfunc(s.in_moments))
    rows[0] = source.EQUATION_4_6 if first else rows[0]
    rows[1] = source.EQUATION_4_7 if second else rows[1]
    return linearised(sp.Matrix(rows), equations).subs(at_rest(equations)).in_moments()


def without_push_back() -> LinearMotion:
    """The run-up script's first fault: the disk's equations do not contain the pendulums' angular accelerations."""
    right = singular_point_matrices()
    inertia = right.inertia.copy()
    inertia[:2, 2:] = sp.zeros(2, 2)
    return LinearMotion(sp.Matrix(inertia), right.damping, right.stiffness)


def with_listed_cell() -> LinearMotion:
    """The generating program's cell (1,4) of the inertia matrix."""
    right = singular_point_matrices()
    inertia = right.inertia.copy()
    inertia[0, 3] = CELL_1_4_AS_LISTED
    return LinearMotion(sp.Matrix(inertia), right.damping, right.stiffness)


@functools.cache
def variants() -> dict[str, NumericMotion]:
    """Type I on unequal springs: the derived matrices, each printed deviation alone, and all together."""
    linear = {
        "derived": singular_point_matrices(),
        "(4-15): cell (4,1)": _with_printed({"4-15": None}),
        "(4-16): cells (1,1), (2,2)": _with_printed({"4-16": ((1, 1), (2, 2))}),
        "(4-16): cells (3,2), (4,2)": _with_printed({"4-16": ((3, 2), (4, 2))}),
        "(4-17): cells (1,1), (2,2)": _with_printed({"4-17": ((1, 1), (2, 2))}),
        "(4-17): cell (3,2)": _with_printed({"4-17": ((3, 2),)}),
        "(4-15), (4-16), (4-17) as printed": _with_printed({"4-15": None, "4-16": None, "4-17": None}),
        "(4-6) as printed, linearised": printed_motion(True, False),
        "(4-7) as printed, linearised": printed_motion(False, True),
        "generating program: M14 from M13": with_listed_cell(),
        "run-up script: no push back": without_push_back(),
    }
    return {name: NumericMotion(motion) for name, motion in linear.items()}


@functools.cache
def isotropic_variants() -> dict[str, NumericMotion]:
    """The variants for equal springs: (3-27), (3-28), (3-29)."""
    linear = {
        "derived": singular_point_matrices().subs(ISOTROPIC),
        "(3-27)": _with_printed({"3-27": None}, True),
        "(3-28)": _with_printed({"3-28": None}, True),
        "(3-29)": _with_printed({"3-29": None}, True),
        "all three": _with_printed({"3-27": None, "3-28": None, "3-29": None}, True),
    }
    return {name: NumericMotion(motion) for name, motion in linear.items()}


def states_at_rest(p: RotorParameters, omega: float) -> dict[str, list[tuple[float, float, float, float]]]:
    """Types I, II, III on equal springs: (Y1, Y2, θ3, θ4) of each solution."""
    found: dict[str, list[tuple[float, float, float, float]]] = {"I": [], "II": [], "III": []}
    for point in singular_points(p, omega):
        found[point.type].append((point.z_m.real, point.z_m.imag, *point.theta_rad))
    return found
