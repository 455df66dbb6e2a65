"""Quantities that are computed once for each fit: stretch factors of its intervals, and the columns of its model."""

from __future__ import annotations

import numpy as np

from identification.ring_down.decay import FittedDecay, once_per_fit
from identification.ring_down.residuals import spectral_stretch


@once_per_fit
def stretches(fitted: FittedDecay) -> np.ndarray:
    """Factor on the standard deviation of each parameter for residuals that exceed the noise or are not white."""
    residuals = [r for record in fitted.channel_residuals() for r in record]
    influence = fitted.solution.minimum.jacobian[: fitted.count] @ fitted.solution.minimum.covariance
    edges = np.cumsum([len(r) for r in residuals])[:-1]
    return spectral_stretch(residuals, np.split(influence, edges), fitted.solution.chi2_per_dof)


@once_per_fit
def known_columns(fitted: FittedDecay) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Columns of the fit (basis and tangent) and residual of each record."""
    known, residuals = list[np.ndarray](), list[np.ndarray]()
    for block, c in zip(fitted.model(fitted.theta), fitted.solution.coefficients, strict=True):
        known.append(np.column_stack([block.basis, block.tangent(c)]))
        residuals.append(block.data - block.basis @ c)
    return known, residuals
