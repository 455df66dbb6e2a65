"""Explicit Runge–Kutta of order 8 with equal steps, all columns at once: the first choice unless stiff or very slow."""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.equations.linearised import PeriodicMatrix
from dynamics.motions.dormand_prince import NODES, STAGES, STEPS, WEIGHTS
from dynamics.stability.floquet.methods import per_radian, span_rad, turned
from dynamics.stability.floquet.small_matrices import evaluate, multiply

NAME = "explicit"
ORDER = 8


@njit(cache=True, error_model="numpy")
def _fundamental(series, span, steps):
    n = series.shape[1]
    h = span / steps
    y, y_stage, a = np.eye(n), np.empty((n, n)), np.empty((n, n))
    k = np.empty((STAGES, n, n))
    for step in range(steps):
        for stage in range(STAGES):
            for i in range(n):  # a slice assignment takes numba two seconds more to compile
                for j in range(n):
                    y_stage[i, j] = y[i, j]
            for earlier in range(stage):
                f = h * STEPS[stage, earlier]
                if f != 0.0:
                    for i in range(n):
                        for j in range(n):
                            y_stage[i, j] += f * k[earlier, i, j]
            evaluate(series, (step + NODES[stage]) * h, a)
            multiply(a, y_stage, k[stage])
        for stage in range(STAGES):
            f = h * WEIGHTS[stage]
            if f != 0.0:
                for i in range(n):
                    for j in range(n):
                        y[i, j] += f * k[stage, i, j]
    return y


def monodromy(matrix: PeriodicMatrix, steps: int) -> NDArray[np.floating]:
    """See MonodromyMethod. Twelve evaluations a step; stable up to about five radians of the fastest rate a step."""
    return turned(matrix, _fundamental(per_radian(matrix), span_rad(matrix), steps))
