"""Directions that nothing holds: constant v with A(ψ) v = 0, a multiplier of exactly 1.

On the borders of balance (S_A + S_B = S_P, |S_A − S_B| = S_P) and without imbalance the pendulums can turn against
or with each other and the balance stays, to first order. Without pendulum damping the drift along v is neutral too,
A(ψ) w = v: a multiplier 1 with a Jordan block, of which rounding would leave half the digits. Both are read off the
matrix and taken out exactly; what remains is well conditioned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.linearised import PeriodicMatrix

_ROUNDING = np.finfo(float).eps
_SLACK = 16.0  # roundings within which two columns count as parallel


def without_neutral(matrix: PeriodicMatrix) -> tuple[PeriodicMatrix, int]:
    """The matrix on what is left when neutral directions of the pendulum angles are divided out.

    Returns:
        The smaller matrix, and how many multipliers of exactly 1 were taken out (0, 1 or 2).
    """
    n = matrix.dimension
    half = n // 2
    if n not in (6, 8):
        return matrix, 0
    angles = np.arange(2, half)
    rows = _real_rows(matrix)
    direction = _null(rows[:, angles])
    if direction is None:
        return matrix, 0
    v = np.zeros(n)
    v[angles] = direction
    w = np.zeros(n)
    w[angles + half] = direction
    pivot = int(np.argmax(np.abs(v)))
    lower = rows[np.arange(len(rows)) % n >= half]  # the upper rows of A w are v itself
    if np.max(np.abs(lower @ w)) <= _SLACK * _ROUNDING * np.max(np.abs(lower)):
        return _quotient(_quotient(matrix, w, pivot + half), v[: n - 1], pivot), 2
    return _quotient(matrix, v, pivot), 1


def _real_rows(matrix: PeriodicMatrix) -> NDArray[np.floating]:
    """All Fourier coefficients as real rows, those of order 0 first; shape ((2m + 1) n, n)."""
    h = matrix.harmonics
    return np.concatenate([h[0].real, *[part for k in h[1:] for part in (k.real, k.imag)]])


def _null(columns: NDArray[np.floating]) -> NDArray[np.floating] | None:
    """The combination of one or two columns that vanishes to rounding, or None."""
    if columns.shape[1] == 1:
        return np.ones(1) if not np.any(columns) else None
    first, second = columns.T
    product, size = float(first @ second), float(second @ second)
    if size == 0 or not np.any(first):
        return np.array([0.0, 1.0]) if size == 0 else np.array([1.0, 0.0])
    factor = -product / size
    rest = np.abs(first + factor * second)
    if np.all(rest <= _SLACK * _ROUNDING * np.max(np.abs(first))):
        return np.array([1.0, factor])
    return None


def _quotient(matrix: PeriodicMatrix, v: NDArray[np.floating], pivot: int) -> PeriodicMatrix:
    """The matrix modulo v: rows lose v's share of the pivot's row, then pivot row and column go."""
    kept = np.flatnonzero(np.arange(matrix.dimension) != pivot)
    share = v / v[pivot]
    rows = matrix.harmonics - share[None, :, None] * matrix.harmonics[:, pivot : pivot + 1, :]
    turn = None if matrix.turn is None else matrix.turn[kept]
    return PeriodicMatrix(np.ascontiguousarray(rows[:, kept][:, :, kept]), matrix.speed_rad_s, turn)
