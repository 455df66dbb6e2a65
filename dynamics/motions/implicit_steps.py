"""One step of the implicit Runge–Kutta method Radau IIA with five stages (order 9, stiffly accurate, L-stable).

It is used for motion with rates far above its frequencies: a pendulum under a strong magnet, a heavily damped column.
The stages Y_j = y + Z_j at the nodes c_j solve Z = h (A ⊗ 1) f(y + Z). In the eigenbasis of A⁻¹ the simplified Newton
iteration splits into one real system and two complex ones of the state's dimension (Hairer & Wanner, Solving Ordinary
Differential Equations II, IV.8). The step's polynomial interpolates y and all stages (degree 5).

The embedded formula adds h γ0 f(t, y), γ0 the real eigenvalue of A, with weights of order 5. Its difference from the
method, multiplied by (1 − h γ0 J)⁻¹ to be bounded for stiff components, is the error estimate. The estimate decreases
with h⁶ like the polynomial's error, so a tolerance has the same meaning at every instant of the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.arrays import Array, Complex, Indices, RealSystem
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import jacobian, rates
from dynamics.equations.phase_segments import phase_within

SOLVED = 5  # number of stages
ORDER = 6  # of the error estimate and of the polynomial, per step
_MAX_ITERATIONS = 12
_MAX_NEWTON_ERROR = 0.02  # remaining Newton error of a stage, in tolerances


_linear_algebra: Any = np.linalg  # numpy types its results as unions


def _method() -> tuple[Array, Array, Complex, Complex, Complex, Array, Array]:
    """Nodes, A⁻¹, its eigenvalues and vectors, error weights and the interpolation matrix, derived from the nodes."""
    legendre = np.polynomial.legendre.Legendre.basis
    nodes: Any = np.sort((legendre(SOLVED) - legendre(SOLVED - 1)).roots().real + 1.0) / 2.0
    for _ in range(3):  # refinement of the roots to the last digit
        shifted, poly = 2.0 * nodes - 1.0, legendre(SOLVED) - legendre(SOLVED - 1)
        nodes = nodes - poly(shifted) / (2.0 * poly.deriv()(shifted))
    nodes[-1] = 1.0
    power = np.arange(SOLVED)
    vandermonde = nodes[:, None] ** power
    a = nodes[:, None] ** (power + 1) / (power + 1) @ _linear_algebra.inv(vandermonde)
    inverse = _linear_algebra.inv(a)
    values, vectors = _linear_algebra.eig(inverse)
    turning = np.imag(values)
    order = np.concatenate([np.flatnonzero(np.abs(turning) < 1e-9), np.flatnonzero(turning > 1e-9)])
    back = _linear_algebra.inv(vectors)
    gamma = 1.0 / np.real(values)[order[0]]
    moments = 1.0 / (power + 1) - gamma * (power == 0)
    weights = (_linear_algebra.solve(vandermonde.T, moments) - a[-1]) @ inverse
    interpolation = _linear_algebra.inv(nodes[:, None] ** (power + 1))
    # one of each conjugate pair represents both, with twice its real part
    pair = np.ascontiguousarray(vectors[:, order]) * np.where(np.arange(len(order)) == 0, 1.0, 2.0)
    return nodes, inverse, values[order], pair, np.ascontiguousarray(back[order]), weights, interpolation


NODES, _INVERSE, _EIGENVALUE, _VECTORS, _BACK, _ERROR, _INTERPOLATION = _method()


@compiled(part=True)
def _factor(m: Complex, pivot: Indices) -> bool:
    """LU factors of m, shape (8, 8), in place with row exchanges; False if m is singular."""
    for c in range(8):
        best, at = 0.0, c
        for r in range(c, 8):
            size = abs(m[r, c].real) + abs(m[r, c].imag)
            if size > best:
                best, at = size, r
        pivot[c] = at
        if not (best > 0.0 and best < np.inf):
            return False
        if at != c:
            for j in range(8):
                m[c, j], m[at, j] = m[at, j], m[c, j]
        for r in range(c + 1, 8):
            m[r, c] /= m[c, c]
            for j in range(c + 1, 8):
                m[r, j] -= m[r, c] * m[c, j]
    return True


@compiled(part=True)
def _solve(m: Complex, pivot: Indices, b: Complex) -> None:
    """Solve with the factors of _factor; b is replaced by the solution, shape (8,)."""
    for c in range(8):
        b[c], b[pivot[c]] = b[pivot[c]], b[c]
    for c in range(8):  # the exchanges of later columns moved the multipliers with their rows
        for r in range(c + 1, 8):
            b[r] -= m[r, c] * b[c]
    for c in range(7, -1, -1):
        for j in range(c + 1, 8):
            b[c] -= m[c, j] * b[j]
        b[c] /= m[c, c]


@compiled(part=True)
def _residuals(
    y: Array,
    t: float,
    h: float,
    first: int,
    last: int,
    system: RealSystem,
    z: Array,
    stage: Array,
    phase: Array,
    residual: Array,
) -> None:
    """Write f(y + Z) − A⁻¹ Z / h to residual, shape (5, 8)."""
    p, free_a, free_b, knots, origins, cubics = system
    for j in range(5):
        for i in range(8):
            stage[i] = y[i] + z[j, i]
        phase_within(t + NODES[j] * h, first, last, knots, origins, cubics, phase)
        rates(stage, phase[0], phase[1], phase[2], p, free_a, free_b, residual[j])
        for i in range(8):
            for other in range(5):
                residual[j, i] -= _INVERSE[j, other] / h * z[other, i]


@compiled(part=True)
def _correct(residual: Array, lu: Complex, pivot: Indices, scale: Array, w: Complex, z: Array) -> float:
    """One simplified Newton correction of the stages; returns its root mean square over scale."""
    for e in range(3):
        for i in range(8):
            w[e, i] = 0.0
            for j in range(5):
                w[e, i] += _BACK[e, j] * residual[j, i]
        _solve(lu[e], pivot[e], w[e])
    size = 0.0
    for j in range(5):
        for i in range(8):
            change = 0.0
            for e in range(3):
                change += (_VECTORS[j, e] * w[e, i]).real
            z[j, i] += change
            size += (change / scale[i]) ** 2
    return np.sqrt(size / 40.0)


@compiled(part=True)
def _newton(
    y: Array,
    t: float,
    h: float,
    first: int,
    last: int,
    system: RealSystem,
    scale: Array,
    lu: Complex,
    pivot: Indices,
    z: Array,
    phase: Array,
) -> bool:
    """Solve for the stages in place. True if the remaining Newton error is far below the tolerance."""
    residual, stage = np.empty((5, 8)), np.empty(8)
    w = np.empty((3, 8), dtype=np.complex128)
    previous, ratio = np.inf, 1.0
    for iteration in range(_MAX_ITERATIONS):
        _residuals(y, t, h, first, last, system, z, stage, phase, residual)
        size = _correct(residual, lu, pivot, scale, w, z)
        if iteration > 0:
            ratio = size / previous
        if not size < np.inf or (ratio >= 1.0 and size > _MAX_NEWTON_ERROR and iteration > 0):
            return False
        if size < 0.01 * _MAX_NEWTON_ERROR or (ratio < 1.0 and size * ratio / (1.0 - ratio) < _MAX_NEWTON_ERROR):
            return True
        previous = size
    return False


@compiled(part=True)
def implicit_step(
    y: Array,
    t: float,
    h: float,
    first: int,
    last: int,
    system: RealSystem,
    scale: Array,
    rate: Array,
    j: Array,
    lu: Complex,
    pivot: Indices,
    z: Array,
    end: Array,
    phase: Array,
) -> float:
    """Write the state after one step to end. Returns the estimated error over scale, or −1 if Newton's method fails.

    Args:
        y, end: shape (8,), float.
        first, last, system: as in dynamics.motions.explicit_steps.explicit_step.
        scale: tolerated error of each component, shape (8,).
        rate: dy/dt at t, shape (8,).
        j: Jacobian at t, shape (8, 8).
        lu, pivot: scratch, shapes (3, 8, 8) complex and (3, 8) integer.
        z: initial stages minus y on entry, solved stages minus y on return, shape (5, 8).
        phase: scratch, shape (3,).
    """
    for e in range(3):
        for r in range(8):
            for c in range(8):
                lu[e, r, c] = -j[r, c]
            lu[e, r, r] += _EIGENVALUE[e] / h
        if not _factor(lu[e], pivot[e]):
            return -1.0
    if not _newton(y, t, h, first, last, system, scale, lu, pivot, z, phase):
        return -1.0
    error = np.empty(8, dtype=np.complex128)
    for i in range(8):
        embedded = 0.0
        for s in range(5):
            embedded += _ERROR[s] * z[s, i]
        error[i] = embedded * _EIGENVALUE[0].real / h + rate[i]
        end[i] = y[i] + z[4, i]
    _solve(lu[0], pivot[0], error)
    return _norm(error, scale)


@compiled(part=True)
def _norm(error: Complex, scale: Array) -> float:
    total = 0.0
    for i in range(8):
        total += (error[i].real / scale[i]) ** 2
    return np.sqrt(total / 8.0)


@compiled(part=True)
def implicit_polynomial(y: Array, z: Array, coefficients: Array) -> None:
    """Write the motion over the step as powers of (time − t)/h, shape (8 powers, 8). The last two powers are zero."""
    for i in range(8):
        coefficients[0, i] = y[i]
        coefficients[6, i] = coefficients[7, i] = 0.0
        for power in range(5):
            total = 0.0
            for s in range(5):
                total += _INTERPOLATION[power, s] * z[s, i]
            coefficients[power + 1, i] = total


@compiled(part=True)
def guess_stages(coefficients: Array, ratio: float, end: Array, z: Array) -> None:
    """Initial stages of the next step from the last step's polynomial; ratio is next over last step length."""
    for s in range(5):
        x = 1.0 + NODES[s] * ratio
        for i in range(8):
            value = coefficients[7, i]
            for power in range(6, -1, -1):
                value = value * x + coefficients[power, i]
            z[s, i] = value - end[i]


@compiled(part=True)
def jacobian_at(y: Array, t: float, first: int, last: int, system: RealSystem, phase: Array, j: Array) -> None:
    """Write the Jacobian of the rates at one instant to j, shape (8, 8)."""
    p, free_a, free_b, knots, origins, cubics = system
    phase_within(t, first, last, knots, origins, cubics, phase)
    jacobian(y, phase[0], phase[1], phase[2], p, free_a, free_b, j)


@compiled(part=True)
def differentiate_stages(
    stages: Array, t: float, h: float, first: int, last: int, system: RealSystem, packed: Array, dy: Array, dz: Array
) -> None:
    """Derivatives of the stages of a recorded step, from the stage equations.

    A⁻¹ Z / h = f(y + Z, p) gives A⁻¹ δZ / h − J_j δZ_j = J_j δy + (∂f/∂p) δp, linear in δZ.

    Args:
        stages: y + Z, shape (5, 8).
        packed: directions δp of the packed parameters, shape (n, 26).
        dy: derivatives of y, shape (n, 8).
        dz: derivatives of Z, shape (n, 5, 8), written.
    """
    p, free_a, free_b, knots, origins, cubics = system
    matrix, right = np.zeros((40, 40)), np.zeros((40, len(dy)))
    phase, j, f = np.empty(3), np.empty((8, 8)), np.empty(8, dtype=np.complex128)
    for s in range(5):
        phase_within(t + NODES[s] * h, first, last, knots, origins, cubics, phase)
        jacobian(stages[s], phase[0], phase[1], phase[2], p, free_a, free_b, j)
        for i in range(8):
            for other in range(5):
                matrix[8 * s + i, 8 * other + i] = _INVERSE[s, other]
        for i in range(8):
            for c in range(8):
                matrix[8 * s + i, 8 * s + c] -= h * j[i, c]
        for column in range(len(dy)):
            rates(
                stages[s] + 1j * 1e-30 * dy[column],
                phase[0],
                phase[1],
                phase[2],
                p + 1j * 1e-30 * packed[column],
                free_a,
                free_b,
                f,
            )
            for i in range(8):
                right[8 * s + i, column] = h * f[i].imag * 1e30
    solution = np.linalg.solve(matrix, right)
    for column in range(len(dy)):
        for s in range(5):
            for i in range(8):
                dz[column, s, i] = solution[8 * s + i, column]
