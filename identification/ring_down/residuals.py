"""Tests of residuals: whiteness, widening of intervals for coloured residuals, score test for missing terms.

The parameters of a least-squares fit whose noise has the spectrum S(f) have the variance

    var = Σ_f |h(f)|² S(f),        h = influence of the parameter (a column of J (JᵀJ)⁻¹) over frequency.

Only noise in the band of the modes counts: hum at 100 Hz has no effect, slow wander has one if damping is strong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from identification.typed_scipy import uniform_filter1d

_SMOOTH = 33  # number of averaged periodogram ordinates; the relative scatter of a level is 1/sqrt(33)
_LAGS = 20


def spectral_stretch(residuals: list[np.ndarray], influence: list[np.ndarray], chi2: float) -> np.ndarray:
    """Factor on the standard deviation of each parameter for residuals that are not white with unit variance.

    Args:
        residuals: residuals of each channel in standard deviations, in time order.
        influence: influence of the residuals on the parameters for each channel, shape (n, p).
        chi2: χ² per degree of freedom of all channels.
    Returns:
        Factors, shape (p,), at least 1. A factor differs from sqrt(chi2) only if the difference is significant (three
        standard deviations).
    """
    coloured = np.zeros(influence[0].shape[1])
    white = np.zeros_like(coloured)
    for residual, h in zip(residuals, influence, strict=True):
        size = 1 << int(np.ceil(np.log2(len(residual))))
        level = np.abs(np.fft.rfft(residual, size)) ** 2 / len(residual)
        level = uniform_filter1d(level, min(_SMOOTH, max(3, len(level) // 4)), mode="nearest")
        share = np.abs(np.fft.rfft(h, size, axis=0)) ** 2
        coloured += level @ share
        white += share.sum(axis=0)
    ratio = coloured / np.maximum(white, 1e-300)
    base = max(1.0, chi2)
    chance = 3 / np.sqrt(_SMOOTH)
    ratio = np.where(ratio < base * (1 - chance), np.maximum(1.0, ratio * (1 + chance)), np.maximum(ratio, base))
    return np.sqrt(np.where((ratio > base) & (ratio < base * (1 + chance)), base, ratio))


@dataclass(frozen=True)
class Whiteness:
    """Portmanteau test of block residuals.

    Attributes:
        p: p value for white noise.
        correlation: autocorrelation with the largest magnitude for lags 1 to 20, signed.
    """

    p: float
    correlation: float


def whiteness(residuals: list[np.ndarray]) -> Whiteness:
    """Ljung–Box test over 20 lags of all channels together."""
    statistic, lags, largest = 0.0, 0, 0.0
    for residual in residuals:
        n = len(residual)
        count = min(_LAGS, n // 5)
        own = residual - residual.mean()
        power = max(float(own @ own), 1e-300)
        rho = np.array([float(own[k:] @ own[:-k]) / power for k in range(1, count + 1)])
        statistic += n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, count + 1))))
        lags += count
        if len(rho) and abs(rho).max() > abs(largest):
            largest = float(rho[np.argmax(np.abs(rho))])
    return Whiteness(float(chdtrc(max(lags, 1), statistic)), largest)


def gain_of(residual: np.ndarray, known: np.ndarray, extra: np.ndarray) -> float:
    """Reduction of χ² if columns were added to a fit (score test); exact for linear terms.

    Args:
        residual: residual of the fit, shape (n,).
        known: columns of the fit (amplitudes, drift, tangent), shape (n, k).
        extra: columns to add, shape (n, m).
    """
    columns = np.column_stack([known, extra])
    columns = columns / (np.sqrt(np.einsum("ij,ij->j", columns, columns)) + 1e-300)
    gram, right = columns.T @ columns, columns.T @ residual
    k = known.shape[1]
    values, vectors = np.linalg.eigh(gram[:k, :k])
    kept = values > 1e-10
    to_known = (vectors[:, kept] / values[kept]) @ (vectors[:, kept].T @ gram[:k, k:])
    own = gram[k:, k:] - gram[k:, :k] @ to_known
    left = right[k:] - to_known.T @ right[:k]
    values, vectors = np.linalg.eigh(own)
    kept = values > 1e-9  # a column in the span of the known ones has no effect
    return float(np.sum((vectors[:, kept].T @ left) ** 2 / values[kept]))
