"""Normal equations of many small linear problems with a normal prior, solved at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array


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
    m = right.shape[-1]
    added = ridge * np.trace(across, axis1=-2, axis2=-1)
    lower, fit, first = np.zeros(across.shape), np.zeros(right.shape), np.zeros(right.shape)
    with np.errstate(divide="ignore", invalid="ignore"):  # without data and prior an unknown has an infinite variance
        for i in range(m):
            for j in range(i):
                element = across[..., i, j] - np.sum(lower[..., i, :j] * lower[..., j, :j], axis=-1)
                lower[..., i, j] = element / lower[..., j, j]
            pivot = across[..., i, i] + prior[:, None, i] + (added if i > 0 else 0.0)
            lower[..., i, i] = np.sqrt(np.maximum(pivot - np.sum(lower[..., i, :i] ** 2, axis=-1), added))
        diagonal = np.diagonal(lower, axis1=-2, axis2=-1)
        for i in range(m):  # forward: of r, and of the first unit vector
            fit[..., i] = (right[..., i] - np.sum(lower[..., i, :i] * fit[..., :i], axis=-1)) / diagonal[..., i]
            unit = 1.0 if i == 0 else 0.0
            first[..., i] = (unit - np.sum(lower[..., i, :i] * first[..., :i], axis=-1)) / diagonal[..., i]
        for i in range(m - 1, -1, -1):
            later = np.sum(lower[..., i + 1 :, i] * fit[..., i + 1 :], axis=-1)
            fit[..., i] = (fit[..., i] - later) / diagonal[..., i]
        log_determinant = 2.0 * np.sum(np.log(diagonal), axis=-1)
    return fit, np.sum(first**2, axis=-1), log_determinant
