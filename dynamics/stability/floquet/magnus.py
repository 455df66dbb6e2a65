"""Magnus integrators: each step is one exponential of a commutator series at Gauss points.

The constant part of A(ψ) is integrated exactly at any rate. Only its change within a step causes an error.
Source: Blanes, Casas, Oteo, Ros, The Magnus expansion and some of its applications, Physics Reports 470 (2009),
section 5.4: with α1 = h A(mid), α2 = √15/3 h (A3 − A1), α3 = 10/3 h (A3 − 2 A2 + A1) at the three Gauss points,
    C1 = [α1, α2],  C2 = −1/60 [α1, 2 α3 + C1],  Ω = α1 + α3/12 + 1/240 [−20 α1 − α3 + C1, α2 + C2]   (order 6).
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned
from dynamics.stability.floquet.small_matrices import exponential, multiply

NAME = "magnus"
ORDER = 6
_NODE = np.sqrt(15.0) / 10.0


@compiled(part=True)
def _commutator(a: Array, b: Array, work: Array, out: Array) -> None:
    multiply(a, b, out)
    multiply(b, a, work)
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] -= work[i, j]


@compiled
def _fundamental(series: Complex, span: float, steps: int) -> Array:
    n = series.shape[1]
    h = span / steps
    y, next_y, omega, step_matrix = np.eye(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    a = np.empty((3, n, n))
    c1, c2, left, work = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((5, n, n))
    scale = h * np.sqrt(15.0) / 3.0
    for step in range(steps):
        middle = (step + 0.5) * h
        evaluate(series, middle - _NODE * h, a[0])
        evaluate(series, middle, a[1])
        evaluate(series, middle + _NODE * h, a[2])
        for i in range(n):
            for j in range(n):
                first, mid, last = a[0, i, j], a[1, i, j], a[2, i, j]
                a[0, i, j] = h * mid
                a[1, i, j] = scale * (last - first)
                a[2, i, j] = h * 10.0 / 3.0 * (last - 2.0 * mid + first)
        _commutator(a[0], a[1], work[0], c1)
        for i in range(n):
            for j in range(n):
                left[i, j] = (2.0 * a[2, i, j] + c1[i, j]) / -60.0
        _commutator(a[0], left, work[0], c2)
        for i in range(n):
            for j in range(n):
                left[i, j] = (-20.0 * a[0, i, j] - a[2, i, j] + c1[i, j]) / 240.0
                c2[i, j] += a[1, i, j]
        _commutator(left, c2, work[0], omega)
        for i in range(n):
            for j in range(n):
                omega[i, j] += a[0, i, j] + a[2, i, j] / 12.0
        exponential(omega, work, step_matrix)
        multiply(step_matrix, y, next_y)
        y, next_y = next_y, y
    return y


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps))
