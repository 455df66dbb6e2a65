"""Chebyshev collocation on equal panels: spectral in the panel, independent of the step-by-step methods.

On the Chebyshev–Lobatto points of a panel the derivative of the interpolating polynomial equals A(ψ) Y at every point
except the first, where Y is given.
Source: L. N. Trefethen, Spectral Methods in MATLAB (SIAM 2000), chapter 6 (differentiation matrix).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned

_linear_algebra: Any = np.linalg  # numpy types its results as unions
NAME = "chebyshev"
DEGREE = 16
ORDER = DEGREE


def _differentiation(degree: int) -> tuple[Array, Array]:
    """Points in ascending order on [−1, 1] and the differentiation matrix, both of size degree + 1."""
    points = -np.cos(np.pi * np.arange(degree + 1) / degree)
    c = np.ones(degree + 1)
    c[0] = c[-1] = 2.0
    c *= (-1.0) ** np.arange(degree + 1)
    apart = points[:, None] - points[None, :] + np.eye(degree + 1)
    d = np.outer(c, 1 / c) / apart
    return points, d - np.diag(d.sum(axis=1))


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod. A step is a panel with a polynomial of degree 16."""
    n, series, span = matrix.dimension, per_radian(matrix), span_rad(matrix)
    points, d = _differentiation(DEGREE)
    derivative = np.kron(d, np.eye(n)) * (2.0 * steps / span)
    y: Array = np.eye(n)
    a = np.empty((n, n))
    for step in range(steps):
        system = derivative.copy()
        for j in range(1, DEGREE + 1):
            evaluate(series, (step + 0.5 * (points[j] + 1.0)) * span / steps, a)
            system[j * n : (j + 1) * n, j * n : (j + 1) * n] -= a
        right = -system[n:, :n] @ y
        system = system[n:, n:]
        size = np.max(np.abs(system), axis=1, keepdims=True)
        try:
            y = _linear_algebra.solve(system / size, right / size)[-n:]
        except np.linalg.LinAlgError:  # usual: another number of steps succeeds
            return np.full((n, n), np.nan)
    return turned(matrix, y)
