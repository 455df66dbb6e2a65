"""The least standard deviation an unbiased estimate can have, from the record's own model by differences.

For samples μ_i(θ) with independent normal noise σ the Fisher information is F_jk = Σ_i ∂_jμ_i ∂_kμ_i / σ², plus one
over each prior's variance; the square roots of diag(F⁻¹) are the Cramér–Rao bound, every other entry of θ being unknown
too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Mean = Callable[[np.ndarray], np.ndarray]


def bound(
    mean: Mean, theta: np.ndarray, step: np.ndarray, noise: float, prior_std: np.ndarray | None = None
) -> np.ndarray:
    """Cramér–Rao bound of every entry of θ, shape (p,).

    Args:
        mean: θ, shape (p,), to the samples without noise, any shape, in the noise's unit.
        theta: the truth, shape (p,).
        step: of the central differences, shape (p,); small against what bends the model, large against rounding.
        noise: standard deviation of one sample.
        prior_std: what is known of each entry beforehand, shape (p,); inf for nothing.
    """
    columns = []
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
