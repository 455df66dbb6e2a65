"""Coloured noise: an autoregressive model of its spectrum, and the whitening of least-squares rows with it.

Residuals of evenly spaced block means follow r_k = Σ φ_j r_{k−j} + e_k. The rows (r_k − Σ φ_j r_{k−j})/s are white.
Applied to data, basis and tangent this is generalised least squares. The first rows use the predictors of lower order,
which Levinson's recursion provides. No row is lost that way; the first rows contain the largest part of a decay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_MAX_ORDER = 24
_SEGMENTS = 4
_MIN_BIC_GAIN = 60.0  # gain of 2 ln(likelihood) beyond BIC's penalty
_MIN_RESIDUALS = 160
_MIN_INNOVATION = 0.1  # innovation variance over white noise variance; a coarse reading at rest has less, by its steps


@dataclass(frozen=True)
class Colour:
    """Autoregressive model of a channel's noise.

    Attributes:
        width_s: duration of the blocks, s.
        noise: standard deviation of the innovations, as white noise of one sample, m.
        rms: ratio of the rms of the blocks' noise to that of the innovations.
        predictors: coefficients φ of order 0, 1 … p.
        scales: prediction errors of these orders over that of order p.
    """

    width_s: float
    noise: float
    rms: float
    predictors: tuple[np.ndarray, ...]
    scales: tuple[float, ...]

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Whiten rows of shape (n,) or (n, m). The result is in units of the innovations."""
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
    """Model a channel's noise from a fit's residuals; None if they are white and not larger than the known noise.

    The model comes from the quieter half of the record, and the spectrum near the modes is replaced by the level on
    both sides of them. Both keep a misfit of the motion out of the noise.

    Args:
        residual: residuals of block means in standard deviations of the white noise, shape (n,), in time order.
        noise: white noise of one sample, m.
        width_s: duration of a block, s.
        modes: (frequency, half-bandwidth) of each mode, Hz.
    """
    if len(residual) < _MIN_RESIDUALS:
        return None
    quiet = _quietest(residual)
    n = len(quiet)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    taper = np.hanning(n) * np.sqrt(8 / 3)  # limits the leakage of a misfit of the modes
    power = np.abs(np.fft.rfft((quiet - quiet.mean()) * taper, size)) ** 2 / n
    spacing = 1 / (size * width_s)
    covariance = np.fft.irfft(_bridged(power, spacing, modes))[: _MAX_ORDER + 1]
    small = float(np.sum((covariance[1:] / covariance[0]) ** 2))
    if covariance[0] < 1 + 6 * np.sqrt(2 / n) and small < min(_MIN_BIC_GAIN / n, 0.05):
        return None  # no predictor could reach the gain that is required below
    predictors, variances = _levinson(covariance)
    criterion = [n * np.log(max(v, 1e-300)) + k * np.log(n) for k, v in enumerate(variances)]
    order = int(np.argmin(criterion))
    white = variances[0] < 1 + 6 * np.sqrt(2 / n) and criterion[0] - criterion[order] < _MIN_BIC_GAIN
    if white or variances[order] < _MIN_INNOVATION:
        return None
    own = np.sqrt(variances[order])
    scales = tuple(float(np.sqrt(v) / own) for v in variances[: order + 1])
    return Colour(
        width_s, noise * float(own), float(np.sqrt(variances[0]) / own), tuple(predictors[: order + 1]), scales
    )


def _quietest(residual: np.ndarray) -> np.ndarray:
    """Return the two neighbouring quarters with the smallest variance."""
    parts = np.array_split(residual, _SEGMENTS)
    energy = [float(np.var(np.concatenate(parts[i : i + 2]))) for i in range(_SEGMENTS - 1)]
    first = int(np.argmin(energy))
    return np.concatenate(parts[first : first + 2])


def _bridged(power: np.ndarray, spacing: float, modes: list[tuple[float, float]]) -> np.ndarray:
    """Replace the spectrum in each mode's band by an interpolation of the levels on both sides."""
    out = power.copy()
    for frequency, half in modes:
        reach = max(0.4, 3 * half)
        a, b = (round((frequency + s * reach) / spacing) for s in (-1, 1))
        margin = max(b - a, 8) // 2
        sides = [out[max(a - margin, 1) : max(a, 1)], out[b : b + margin]]
        levels = [float(s.mean()) for s in sides if len(s)]
        if levels and b > 0 and a < len(out):
            ends = (levels[0], levels[-1])
            first, last = max(a, 0), min(b, len(out))
            out[first:last] = np.geomspace(max(ends[0], 1e-300), max(ends[1], 1e-300), last - first)
    return out


def _levinson(covariance: np.ndarray) -> tuple[list[np.ndarray], list[float]]:
    """Predictors and prediction error variances of order 0, 1 … (Levinson's recursion)."""
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
