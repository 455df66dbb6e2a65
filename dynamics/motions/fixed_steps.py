"""Motion by classical Runge–Kutta steps of a given length. The steps are the same for every trial of a fit."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import rk4_step
from dynamics.equations.speed_history import phase_at


@compiled
def integrate(
    y0: Array, times: Array, step: float, knots: Array, coefficients: Array, p: Array, free_a: float, free_b: float
) -> Array:
    """States at the given times by classical Runge–Kutta steps no longer than `step`.

    Args:
        y0: shape (8,), state at times[0].
        times: shape (n,), ascending.
    Returns:
        shape (n, 8).
    """
    out = np.empty((len(times), 8))
    y = y0.copy()
    for state in range(8):  # numba compiles an assignment of a row slowly
        out[0, state] = y[state]
    scratch = np.empty((5, 8))
    ph = np.empty((3, 3))
    segment = phase_at(times[0], 0, knots, coefficients, ph[0])
    for i in range(1, len(times)):
        t = times[i - 1]
        n = max(1, int(np.ceil((times[i] - t) / step - 1e-9)))
        h = (times[i] - t) / n
        for j in range(n):
            segment = phase_at(t + (j + 0.5) * h, segment, knots, coefficients, ph[1])
            segment = phase_at(t + (j + 1) * h, segment, knots, coefficients, ph[2])
            rk4_step(
                y,
                h,
                ph[0],
                ph[1],
                ph[2],
                p,
                free_a,
                free_b,
                scratch[0],
                scratch[1],
                scratch[2],
                scratch[3],
                scratch[4],
            )
            for part in range(3):
                ph[0, part] = ph[2, part]
        for state in range(8):
            out[i, state] = y[state]
    return out
