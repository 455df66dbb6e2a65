"""Noise that is not white: its spectrum as an autoregression, and rows of a least-squares problem made white by it.

Residuals of evenly spaced block means follow r_k = Σ φ_j r_{k−j} + e_k. The rows (r_k − Σ φ_j r_{k−j})/s are white;
applied to data, basis and tangent alike this is generalised least squares. The first rows take the predictors of lower
order (Levinson's recursion has them all), so no row is lost, and the first ones hold the most of a decay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_HIGHEST_ORDER = 24
_SEGMENTS = 4
_CLEARLY = 60.0  # of the likelihood's logarithm, twice, beyond what BIC asks
_LEAST = 160  # residuals
_LEAST_INNOVATION = 0.1  # of the white noise's variance: a coarse reading at rest shows none, and is no measure


@dataclass(frozen=True)
class Colour:
    """A channel's noise.

    Attributes:
        width_s: of the blocks it was found for.
        noise: of the innovations, as the white noise of one sample, m.
        rms: of the blocks' noise over that of the innovations.
        predictors: φ of order 0, 1 … p.
        scales: prediction errors of these orders over that of the last.
    """

    width_s: float
    noise: float
    rms: float
    predictors: tuple[np.ndarray, ...]
    scales: tuple[float, ...]

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Rows (n,) or (n, m), in units of the innovations, with their correlation taken out."""
        order = len(self.predictors) - 1
        if order == 0:
            return rows
        out = rows.copy()
        for j, weight in enumerate(self.predictors[-1], 1):
            out[j:] -= weight * rows[:-j]
        for k in range(min(order, len(rows))):
            own = rows[k] - sum(w * rows[k - j] for j, w in enumerate(self.predictors[k], 1))
            out[k] = own / self.scales[k]
        return out


def colour_of(residual: np.ndarray, noise: float, width_s: float, modes: list[tuple[float, float]]) -> Colour | None:
    """The colour of a channel's noise from a fit's residuals; None where they are white and no larger than known.

    Taken from the quieter half of the record, so that a misfit of the motion does not pass for noise, and with the
    spectrum near the modes replaced by what is beside them, for the same reason.

    Args:
        residual: of block means in standard deviations of white noise, shape (n,), in time order.
        noise: that of one sample, m.
        width_s: of a block.
        modes: (frequency, half-bandwidth) of each, Hz.
    """
    if len(residual) < _LEAST:
        return None
    quiet = _quietest(residual)
    n = len(quiet)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    taper = np.hanning(n) * np.sqrt(8 / 3)  # a misfit of the modes must not leak far
    power = np.abs(np.fft.rfft((quiet - quiet.mean()) * taper, size)) ** 2 / n
    spacing = 1 / (size * width_s)
    covariance = np.fft.irfft(_bridged(power, spacing, modes))[: _HIGHEST_ORDER + 1]
    small = float(np.sum((covariance[1:] / covariance[0]) ** 2))
    if covariance[0] < 1 + 6 * np.sqrt(2 / n) and small < min(_CLEARLY / n, 0.05):
        return None  # no predictor could gain what is asked below
    predictors, variances = _levinson(covariance)
    criterion = [n * np.log(max(v, 1e-300)) + k * np.log(n) for k, v in enumerate(variances)]
    order = int(np.argmin(criterion))
    white = variances[0] < 1 + 6 * np.sqrt(2 / n) and criterion[0] - criterion[order] < _CLEARLY
    if white or variances[order] < _LEAST_INNOVATION:
        return None
    own = np.sqrt(variances[order])
    scales = tuple(float(np.sqrt(v) / own) for v in variances[: order + 1])
    return Colour(
        width_s, noise * float(own), float(np.sqrt(variances[0]) / own), tuple(predictors[: order + 1]), scales
    )


def _quietest(residual: np.ndarray) -> np.ndarray:
    """The two neighbouring quarters that scatter least."""
    parts = np.array_split(residual, _SEGMENTS)
    energy = [float(np.var(np.concatenate(parts[i : i + 2]))) for i in range(_SEGMENTS - 1)]
    first = int(np.argmin(energy))
    return np.concatenate(parts[first : first + 2])


def _bridged(power: np.ndarray, spacing: float, modes: list[tuple[float, float]]) -> np.ndarray:
    """The spectrum with each mode's band replaced by the level beside it."""
    out = power.copy()
    for frequency, half in modes:
        reach = max(0.4, 3 * half)
        a, b = (round((frequency + s * reach) / spacing) for s in (-1, 1))
        beside = max(b - a, 8) // 2
        sides = [out[max(a - beside, 1) : max(a, 1)], out[b : b + beside]]
        levels = [float(s.mean()) for s in sides if len(s)]
        if levels and b > 0 and a < len(out):
            ends = (levels[0], levels[-1])
            first, last = max(a, 0), min(b, len(out))
            out[first:last] = np.geomspace(max(ends[0], 1e-300), max(ends[1], 1e-300), last - first)
    return out


def _levinson(covariance: np.ndarray) -> tuple[list[np.ndarray], list[float]]:
    """Predictors and prediction error variances of order 0, 1 …"""
    predictors, variances = [np.empty(0)], [float(covariance[0])]
    for k in range(1, len(covariance)):
        last, error = predictors[-1], variances[-1]
        if error <= 1e-12 * covariance[0]:
            break
        reflection = float(covariance[k] - last @ covariance[k - 1 : 0 : -1]) / error
        if abs(reflection) >= 1:
            break
        predictors.append(np.r_[last - reflection * last[::-1], reflection])
        variances.append(error * (1 - reflection**2))
    return predictors, variances
