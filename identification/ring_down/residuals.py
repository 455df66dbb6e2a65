"""What residuals say: are they white, how wide must intervals be if not, which term is missing.

A least-squares fit whose noise has the spectrum S(f) instead of a white one has parameters with

    var = Σ_f |h(f)|² S(f),        h = the parameter's influence (a column of J (JᵀJ)⁻¹) in frequency,

so only noise in the modes' own band counts: hum at 100 Hz does no harm, slow wander does when damping is strong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtrc

_SMOOTH = 33  # periodogram ordinates averaged; the scatter of a level is 1/sqrt(33)
_LAGS = 20


def spectral_stretch(residuals: list[np.ndarray], influence: list[np.ndarray], chi2: float) -> np.ndarray:
    """By how much each parameter's std must be multiplied for residuals that are not white of unit variance.

    Args:
        residuals: per channel, in standard deviations, in time order.
        influence: per channel, shape (n, p).
        chi2: χ² per degree of freedom of all of them.
    Returns:
        shape (p,), at least 1; it differs from sqrt(chi2) only by more than chance (three standard deviations).
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
    """A portmanteau test on block residuals.

    Attributes:
        p: probability of so much correlation in white noise.
        correlation: largest autocorrelation of lags 1 to 20, signed.
    """

    p: float
    correlation: float


def whiteness(residuals: list[np.ndarray]) -> Whiteness:
    """Ljung–Box over 20 lags of all channels together."""
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
    """By how much χ² would fall if columns were added to a fit (score test); exact for linear terms.

    Args:
        residual: shape (n,), of the fit.
        known: columns along which the fit was already free, shape (n, k): amplitudes, drift and tangent.
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
    kept = values > 1e-9  # a column that the known ones span adds nothing
    return float(np.sum((vectors[:, kept].T @ left) ** 2 / values[kept]))
