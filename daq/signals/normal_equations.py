"""Normal equations of many small linear problems with a normal prior, solved at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig_basics.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def _decompose(across: Array, prior: Array, added: float, lower: Array) -> float:
    """Write Cholesky's factor into `lower`; return the logarithm of the determinant."""
    log_determinant = 0.0
    for i in range(len(prior)):
        for j in range(i):
            element = across[i, j]
            for k in range(j):
                element -= lower[i, k] * lower[j, k]
            lower[i, j] = element / lower[j, j]
        pivot = across[i, i] + prior[i] + (added if i > 0 else 0.0)
        for k in range(i):
            pivot -= lower[i, k] * lower[i, k]
        lower[i, i] = np.sqrt(max(pivot, added))
        log_determinant += 2.0 * np.log(lower[i, i])
    return log_determinant


@njit(cache=True, nogil=True, error_model="numpy")
def solve(across: Array, right: Array, prior: Array, ridge: float) -> tuple[NDArray[np.float64], Array, Array]:
    """Solve (A + P) x = r by Cholesky's decomposition, for each quantity and each point of a grid.

    Args:
        across, right: A, shape (q, g, m, m), and r, shape (q, g, m), of the data.
        prior: diagonal of P, the precision of each unknown's prior, shape (q, m).
        ridge: share of the trace of A that is added to each diagonal element but the first, so that shapes which are
            nearly equal do not make the matrix singular.
    Returns:
        x, shape (q, g, m); variance of its first element, shape (q, g); logarithm of the determinant, shape (q, g).
    """
    count, points, m = right.shape
    fit, variance, log_determinant = np.empty((count, points, m)), np.empty((count, points)), np.empty((count, points))
    lower, first = np.empty((m, m)), np.empty(m)
    for q in range(count):
        for g in range(points):
            added = 0.0
            for i in range(m):
                added += ridge * across[q, g, i, i]
            log_determinant[q, g] = _decompose(across[q, g], prior[q], added, lower)
            squares = 0.0
            for i in range(m):  # forward: of r, and of the first unit vector
                value, unit = right[q, g, i], 1.0 if i == 0 else 0.0
                for k in range(i):
                    value -= lower[i, k] * fit[q, g, k]
                    unit -= lower[i, k] * first[k]
                fit[q, g, i], first[i] = value / lower[i, i], unit / lower[i, i]
                squares += first[i] * first[i]
            variance[q, g] = squares
            for i in range(m - 1, -1, -1):
                value = fit[q, g, i]
                for k in range(i + 1, m):
                    value -= lower[k, i] * fit[q, g, k]
                fit[q, g, i] = value / lower[i, i]
    return fit, variance, log_determinant


def compile_solve() -> None:
    """Compile `solve`, or load it from the cache, so that no look of a guided test is delayed by the compilation."""
    solve(np.ones((1, 1, 1, 1)), np.ones((1, 1, 1)), np.zeros((1, 1)), 0.0)
