"""All columns of the fundamental matrix in one adaptive run (scipy's DOP853): slow, independent of other methods."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.stability.floquet.methods import per_radian, span_rad, turned

NAME = "single pass"
ORDER = 8


def monodromy(matrix: PeriodicMatrix, steps: int) -> Array:
    """See MonodromyMethod. The run selects its own steps. `steps` sets its tolerance, steps^−8."""
    integrators: Any = importlib.import_module("scipy.integrate")  # takes 0.3 s; no other method uses it

    n, series = matrix.dimension, per_radian(matrix)
    a = np.empty((n, n))

    def rate(phase: float, y: Array) -> Array:
        evaluate(series, phase, a)
        return (a @ y.reshape(n, n)).ravel()

    tolerance = max(float(steps) ** -ORDER, 3e-14)
    run = integrators.solve_ivp(
        rate, (0.0, span_rad(matrix)), np.eye(n).ravel(), "DOP853", rtol=tolerance, atol=tolerance, t_eval=None
    )
    if not run.success:
        return np.full((n, n), np.nan)
    return turned(matrix, run.y[:, -1].reshape(n, n))
