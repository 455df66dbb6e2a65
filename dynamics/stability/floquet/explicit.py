"""Explicit Runge–Kutta of order 8 with equal steps, all columns at once: default unless stiff or very slow."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix
from dynamics.motions.dormand_prince import NODES, STAGES, STEPS, WEIGHTS
from dynamics.stability.floquet.methods import per_radian, span_rad, turned

NAME = "explicit"
ORDER = 8


_COLUMNS = 8  # processed together; a constant lets the compiler use full vectors


@compiled(part=True)
def _real_series(series: Complex) -> Array:
    """Real parts, then negative imaginary parts, of the coefficients: A(ψ) = Σ_p wave_p part_p; shape (2m + 1, n²)."""
    orders, n = series.shape[0], series.shape[1]
    parts = np.empty((2 * orders - 1, n * n))
    for k in range(orders):
        for i in range(n):
            for j in range(n):
                parts[max(2 * k - 1, 0), i * n + j] = series[k, i, j].real
                if k > 0:
                    parts[2 * k, i * n + j] = -series[k, i, j].imag
    return parts


@compiled(contract=True, part=True)
def _matrix_at(parts: Array, c: float, s: float, a: Array) -> None:
    """Write A(ψ) to a, shape (n²,), from c = cos ψ and s = sin ψ; multiples of ψ by the addition theorem."""
    x, y = 1.0, 0.0
    for i in range(len(a)):
        a[i] = parts[0, i]
    for k in range(1, len(parts), 2):
        x, y = x * c - y * s, x * s + y * c
        for i in range(len(a)):
            a[i] += x * parts[k, i] + y * parts[k + 1, i]


@compiled(contract=True, part=True)
def _times(a: Array, y: Array, out: Array) -> None:
    """out = a y with a (n²,), y and out (n · 8,). Zeros of a row are skipped; half of the rows are unit rows."""
    n = len(y) // _COLUMNS
    for i in range(n):
        row = out[i * _COLUMNS : (i + 1) * _COLUMNS]
        for j in range(_COLUMNS):
            row[j] = 0.0
        for k in range(n):
            f = a[i * n + k]
            if f != 0.0:
                for j in range(_COLUMNS):
                    row[j] += f * y[k * _COLUMNS + j]


@compiled(contract=True)
def _fundamental(series: Complex, span: float, steps: int) -> Array:
    n = series.shape[1]
    size, h = n * _COLUMNS, span / steps
    parts, whole = _real_series(series), np.empty((n, n))
    y, y_stage, a, k = np.empty(size), np.empty(size), np.empty(n * n), np.empty((STAGES, size))
    node_cos, node_sin = np.cos(NODES * h), np.sin(NODES * h)
    for first in range(0, n, _COLUMNS):
        for i in range(n):
            for j in range(_COLUMNS):
                y[i * _COLUMNS + j] = 1.0 if i == first + j else 0.0
        for step in range(steps):
            c, s = np.cos(step * h), np.sin(step * h)
            for stage in range(STAGES + 1):
                for i in range(size):
                    y_stage[i] = y[i]
                for earlier in range(stage):
                    f = h * (STEPS[stage, earlier] if stage < STAGES else WEIGHTS[earlier])
                    if f != 0.0:
                        for i in range(size):
                            y_stage[i] += f * k[earlier, i]
                if stage < STAGES:
                    on_c, on_s = node_cos[stage], node_sin[stage]
                    _matrix_at(parts, c * on_c - s * on_s, s * on_c + c * on_s, a)
                    _times(a, y_stage, k[stage])
            y, y_stage = y_stage, y
        for i in range(n):
            for j in range(min(_COLUMNS, n - first)):
                whole[i, first + j] = y[i * _COLUMNS + j]
    return whole


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod. Twelve evaluations a step; stable up to about five radians of the fastest rate a step."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps))
