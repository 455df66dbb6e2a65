"""Smallest standard deviation of an unbiased estimate, from the model of a record by numerical differences.

For samples μ_i(θ) with independent normal noise σ the Fisher information is F_jk = Σ_i ∂_jμ_i ∂_kμ_i / σ², plus the
inverse variance of each prior. The square roots of diag(F⁻¹) are the Cramér–Rao bound, with all other entries of θ
unknown as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rig_basics.arrays import Array

Mean = Callable[[Array], Array]


def bound(mean: Mean, theta: Array, step: Array, noise: float, prior_std: Array | None = None) -> Array:
    """Return the Cramér–Rao bound of every entry of θ, shape (p,).

    Args:
        mean: maps θ, shape (p,), to the samples without noise, any shape, in the noise's unit.
        theta: true values, shape (p,).
        step: half-widths of the central differences, shape (p,), small against the curvature of the model and large
            against rounding.
        noise: standard deviation of one sample.
        prior_std: prior standard deviation of each entry, shape (p,); inf for no prior.
    """
    columns: list[Array] = []
    for j, h in enumerate(step):
        up, down = theta.copy(), theta.copy()
        up[j] += h
        down[j] -= h
        columns.append((mean(up) - mean(down)).ravel() / (2 * h * noise))
    jacobian = np.column_stack(columns)
    information = jacobian.T @ jacobian
    if prior_std is not None:
        information += np.diag(1 / prior_std**2)
    scale = np.sqrt(np.diag(information))
    return np.sqrt(np.diag(np.linalg.inv(information / np.outer(scale, scale)))) / scale
