"""The matrix is constant over each step: a product of exponentials, second order.

The value at the middle or at the end of the step differs by a phase shift of half a step. This is a similarity
transform of the monodromy matrix, so the multipliers are the same.
Source: the piecewise-constant scheme of C. S. Hsu (1974); here each exponential is computed to rounding.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned
from dynamics.stability.floquet.small_matrices import exponential, multiply

NAME = "piecewise"
ORDER = 2


@compiled
def _fundamental(series: Complex, span: float, steps: int, offset: float) -> Array:
    n = series.shape[1]
    h = span / steps
    y, next_y, a, step_matrix = np.eye(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    work = np.empty((5, n, n))
    for step in range(steps):
        evaluate(series, (step + offset) * h, a)
        for i in range(n):
            for j in range(n):
                a[i, j] *= h
        exponential(a, work, step_matrix)
        multiply(step_matrix, y, next_y)
        y, next_y = next_y, y
    return y


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod. The matrix has its value at the middle of each step."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps, 0.5))


def sampled_at_ends(matrix: PeriodicMatrix, steps: int) -> Array:
    """Monodromy matrix with the matrix's value at the end of each step; the multipliers are the same."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps, 1.0))
