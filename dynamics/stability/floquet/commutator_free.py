"""Commutator-free Magnus integrator of order 4: two exponentials a step, no commutator.

    y ← exp(h(a₋ A1 + a₊ A2)) exp(h(a₊ A1 + a₋ A2)) y,   a± = 1/4 ± √3/6, at the two Gauss points.
A commutator would multiply the step's error by the fastest rate. Without it a stiff constant part does not increase
the error, and the oscillations are integrated exactly. The method suits motions that are stiff and undamped at once.
Source: S. Blanes, P. C. Moan, Applied Numerical Mathematics 56 (2006) 1519.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned
from dynamics.stability.floquet.small_matrices import exponential, multiply

NAME = "commutator-free"
ORDER = 4
_NODE = np.sqrt(3.0) / 6.0


@compiled
def _fundamental(series: Complex, span: float, steps: int) -> Array:
    n = series.shape[1]
    h = span / steps
    y, next_y, mixed, step_matrix = np.eye(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    first, second, work = np.empty((n, n)), np.empty((n, n)), np.empty((5, n, n))
    for step in range(steps):
        evaluate(series, (step + 0.5 - _NODE) * h, first)
        evaluate(series, (step + 0.5 + _NODE) * h, second)
        for half in range(2):
            near = h * (0.25 + _NODE if half == 0 else 0.25 - _NODE)
            far = 0.5 * h - near
            for i in range(n):
                for j in range(n):
                    mixed[i, j] = near * first[i, j] + far * second[i, j]
            exponential(mixed, work, step_matrix)
            multiply(step_matrix, y, next_y)
            y, next_y = next_y, y
    return y


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps))
