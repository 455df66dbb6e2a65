"""Neutral directions: constant v with A(ψ) v = 0, a multiplier of exactly 1.

On the borders of the balancing region (S_A + S_B = S_P, |S_A − S_B| = S_P) and without imbalance, the pendulums can
turn against or with each other without a change of the balance, to first order. Without pendulum damping the drift
along v is neutral too, A(ψ) w = v: a multiplier 1 with a Jordan block, which loses half the digits to rounding. Both
are determined from the matrix and removed exactly. The remaining matrix is well conditioned.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix

_ROUNDING = float(np.finfo(float).eps)
_SLACK = 16.0  # roundings within which two columns count as parallel


def without_neutral(matrix: PeriodicMatrix) -> tuple[PeriodicMatrix, int]:
    """The matrix with neutral directions of the pendulum angles divided out.

    Returns:
        The smaller matrix, and the number of removed multipliers of exactly 1 (0, 1 or 2).
    """
    n = matrix.dimension
    half = n // 2
    if n not in (6, 8):
        return matrix, 0
    series, direction = np.ascontiguousarray(matrix.harmonics, np.complex128), np.zeros(half)
    if not _neutral_direction(series, direction):
        return matrix, 0
    v, w = np.zeros(n), np.zeros(n)
    v[:half] = direction
    w[half:] = direction
    pivot = int(np.argmax(np.abs(v)))
    rows = _real_rows(matrix)
    lower = rows[np.arange(len(rows)) % n >= half]  # the upper rows of A w are v
    if np.max(np.abs(lower @ w)) <= _SLACK * _ROUNDING * np.max(np.abs(lower)):
        return _quotient(_quotient(matrix, w, pivot + half), v[: n - 1], pivot), 2
    return _quotient(matrix, v, pivot), 1


def _real_rows(matrix: PeriodicMatrix) -> Array:
    """All Fourier coefficients as real rows, those of order 0 first; shape ((2m + 1) n, n)."""
    h = matrix.harmonics
    return np.concatenate([h[0].real, *[part for k in h[1:] for part in (k.real, k.imag)]])


@compiled
def _neutral_direction(series: Complex, direction: Array) -> bool:
    """Write the combination of the columns of the one or two angles that vanishes to rounding to direction (n/2,).

    Args:
        series: complex, shape (m + 1, n, n); the angles are the states from 2 to n/2.
        direction: must contain zeros.
    Returns:
        Whether such a combination exists.
    """
    orders, half = series.shape[0], series.shape[1] // 2
    last = half - 1  # 2 if there is a single angle
    product, own, largest = 0.0, 0.0, 0.0
    for k in range(orders):
        for row in range(2 * half):
            first, second = series[k, row, 2], series[k, row, last]
            product += first.real * second.real
            own += second.real * second.real
            largest = max(largest, abs(first.real))
            if k > 0:
                product += first.imag * second.imag
                own += second.imag * second.imag
                largest = max(largest, abs(first.imag))
    if own == 0.0:
        direction[last] = 1.0
        return True
    if last == 2:
        return False
    if largest == 0.0:
        direction[2] = 1.0
        return True
    factor = -product / own
    for k in range(orders):
        for row in range(2 * half):
            rest = series[k, row, 2] + factor * series[k, row, last]
            if abs(rest.real) > _SLACK * _ROUNDING * largest:
                return False
            if k > 0 and abs(rest.imag) > _SLACK * _ROUNDING * largest:
                return False
    direction[2], direction[last] = 1.0, factor
    return True


def _quotient(matrix: PeriodicMatrix, v: Array, pivot: int) -> PeriodicMatrix:
    """The matrix modulo v: v's share of the pivot's row is subtracted from the rows, then pivot row and column go."""
    kept = np.flatnonzero(np.arange(matrix.dimension) != pivot)
    share = v / v[pivot]
    rows = matrix.harmonics - share[None, :, None] * matrix.harmonics[:, pivot : pivot + 1, :]
    turn = None if matrix.turn is None else matrix.turn[kept]
    return PeriodicMatrix(np.ascontiguousarray(rows[:, kept][:, :, kept]), matrix.speed_rad_s, turn)
