"""Uncertainty of a displacement's order-1 vector in a window, from the noise at the order's own frequency.

A fit over m whole revolutions of duration T is a rectangular window on the signal: the vector's variance is ∫ S |H|² df
of the noise's spectrum S, with H ~ sinc(π(f − m/T)T). Slow parts, hum and noise near the order therefore leak into the
vector. The coefficients at k/m of the rotor's frequency, with k not a multiple of m, have the same window
and the same leakage. They contain no motion except the leakage of a changing vector, which is computed from the change
and removed. Their power, interpolated to k = m as a power law, is the vector's variance for any noise spectrum.
Differences of neighbouring samples contain the white part only.
Source: docs/theory/detection_of_steady_states.md, "Noise that is not white".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array, Complex

_REACH = 6  # coefficients on either side of the order
_MIN_BINS, _MIN_WINDOWS = 3, 6
_NEWEST = 15  # windows: the motion may have changed before
_MIN_DEVIATIONS = 3.0  # deviations of a level's logarithm
_OF_MEDIAN = math.log(2.0)  # ratio of an exponential variable's median to its mean
_LOG_SCATTER = 1 / _OF_MEDIAN  # deviation of a median's logarithm times the square root of the number of values
_MAX_SLOPE = 4.0  # exponent of the power law of laboratory noise
_MAX_CORRELATION = 0.45  # below 1/2, where correlated neighbours still give a positive definite covariance


@dataclass(frozen=True)
class OrderNoise:
    """Noise of an order-1 vector beyond the white part.

    Attributes:
        real, imaginary: ratio of the standard deviation of that part of the vector to that from white noise alone; both
            1 if only white noise is found.
        neighbours: correlation of the errors of two adjacent windows; 0 if none is found.
    """

    real: float = 1.0
    imaginary: float = 1.0
    neighbours: float = 0.0


def order_noise(windows: Sequence[tuple[Array, Array]], vectors: Complex, white: float, turns: int) -> OrderNoise:
    """Estimate the noise of order-1 vectors from the coefficients next to the order.

    Args:
        windows: ψ in rad and the residual of the signal after orders 0 to 2, for each window in order, shapes (n,)
            with its own n; each window is `turns` revolutions long.
        vectors: X of each window, x = Re(X e^{iψ}), shape (windows,), unit of the signal.
        white: standard deviation of the real or the imaginary part of X from white noise.
        turns: number of revolutions m.
    """
    bins = [k for k in range(max(1, turns - _REACH), turns + _REACH + 1) if k % turns]
    first = max(0, len(windows) - _NEWEST)
    if len(bins) < _MIN_BINS or len(windows) - first < _MIN_WINDOWS or not white > 0:
        return OrderNoise()
    coefficients = np.array(
        [_coefficients(phase - phase[0], residual, turns, bins) for phase, residual in windows[first:]]
    )
    begin = np.exp(1j * np.array([phase[0] for phase, _ in windows[first:]]))[:, None]
    coefficients -= _leaked(np.gradient(vectors)[first:, None] * begin, turns, np.array(bins))
    levels = np.maximum(np.median(np.abs(coefficients) ** 2, axis=0), 1e-300) / _OF_MEDIAN
    level, scatter = _at_order(np.array(bins) / turns, levels, len(coefficients))
    above = level - math.log(2 * white**2)
    if above < _MIN_DEVIATIONS * scatter:
        return OrderNoise()
    scaled = coefficients / np.sqrt(levels)
    turned = scaled / begin
    parts = np.median(np.real(turned) ** 2), np.median(np.imag(turned) ** 2)
    real, imaginary = (math.sqrt(math.exp(above) * 2 * float(part) / float(sum(parts))) for part in parts)
    return OrderNoise(max(1.0, real), max(1.0, imaginary), _neighbours(scaled))


def _coefficients(phase: Array, residual: Array, turns: int, bins: Sequence[int]) -> Complex:
    """Return 2/n Σ r e^{−ikψ/m} of each bin, shape (bins,)."""
    step = np.exp(-1j / turns * phase)
    wave = step ** bins[0]
    found = np.empty(len(bins), np.complex128)
    for j, k in enumerate(bins):
        wave = wave * step ** (k - bins[j - 1]) if j else wave
        found[j] = 2 * (wave @ residual) / len(residual)
    return found


def _leaked(change: Complex, turns: int, bins: NDArray[np.int_]) -> Complex:
    """Return the leakage of a vector that changes by Δ along a window into the bins, shape (windows, bins).

    Δ/(2πi(m−k)) − Δ*/(2πi(m+k)), the coefficients of Re(Δ(u − ½) e^{2πimu}), u from 0 to 1.

    Args:
        change: Δ, with ψ counted from the window's start, shape (windows, 1).
    """
    return np.asarray((change / (turns - bins) - np.conj(change) / (turns + bins)) / (2j * math.pi), np.complex128)


def _at_order(order: Array, levels: Array, windows: int) -> tuple[float, float]:
    """Logarithm of the level at order 1 by a power law through the levels next to it, and its standard deviation."""
    design = np.stack([np.ones_like(order), np.log(order)], axis=1)
    normal = np.linalg.inv(design.T @ design)
    level, slope = normal @ design.T @ np.log(levels)
    scatter = _LOG_SCATTER * math.sqrt(float(normal[0, 0]) / windows)
    if abs(slope) > _MAX_SLOPE:
        level = float(np.mean(np.log(levels) - math.copysign(_MAX_SLOPE, slope) * design[:, 1]))
    return float(level), scatter


def _neighbours(scaled: Complex) -> float:
    """Return the correlation of a coefficient with that of the next window; 0 if it is not significant.

    A negative correlation would make a mean's errors cancel. It is not used: a beat of hum with the windows looks the
    same for a while.
    """
    products = np.real(np.conj(scaled[:-1]) * scaled[1:])
    found = float(products.sum() / np.sum(np.abs(scaled) ** 2)) * len(scaled) / (len(scaled) - 1)
    is_significant = found > _MIN_DEVIATIONS / math.sqrt(2 * products.size)
    return min(found, _MAX_CORRELATION) if is_significant else 0.0
