# pyright: strict
"""How well a displacement's order-1 vector is known in a window: by the noise at the order's own frequency.

A fit over m whole revolutions is a rectangular window on the signal, so that what is slow, hum and noise near the order
all leak into the vector. The coefficients at k/m of the rotor's frequency, k no multiple of m, have the same window and
the same leakage and hold no motion but what a changing vector leaks into them, which is known from the change and taken
out. Their power, interpolated to k = m as a power law, is the vector's variance, whatever the noise's spectrum;
differences of neighbouring samples see its white part alone.
Source: docs/theory/steady_states.md, "Noise that is not white".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_REACH = 6  # coefficients to either side of the order
_FEWEST_BINS, _FEWEST_WINDOWS = 3, 6
_NEWEST = 15  # windows: farther back the motion may have been another
_SURE = 3.0  # deviations of a level's logarithm
_OF_MEDIAN = math.log(2.0)  # an exponential variable's median over its mean
_LOG_SCATTER = 1 / _OF_MEDIAN  # of a median's logarithm, times the square root of the number
_STEEPEST = 4.0  # power law of a laboratory's noise
_MOST_CORRELATED = 0.45  # below 1/2, where neighbours alone leave a covariance


@dataclass(frozen=True)
class OrderNoise:
    """Noise of an order-1 vector beyond the white part.

    Attributes:
        real, imaginary: standard deviation of that part of the vector over what white noise alone leaves; both 1 where
            no more than white noise is seen.
        neighbours: correlation of the errors of two windows that meet; 0 where none is seen.
    """

    real: float = 1.0
    imaginary: float = 1.0
    neighbours: float = 0.0


def order_noise(windows: Sequence[tuple[Array, Array]], vectors: Complex, white: float, turns: int) -> OrderNoise:
    """The noise of order-1 vectors from the coefficients beside the order.

    Args:
        windows: of each, in order: ψ in rad and what orders 0 to 2 leave of the signal, shapes (n,), n its own; each
            `turns` revolutions long.
        vectors: X of each window, x = Re(X e^{iψ}), shape (windows,), unit of the signal.
        white: standard deviation that white noise leaves in the real or the imaginary part of X.
        turns: m.
    """
    bins = [k for k in range(max(1, turns - _REACH), turns + _REACH + 1) if k % turns]
    first = max(0, len(windows) - _NEWEST)
    if len(bins) < _FEWEST_BINS or len(windows) - first < _FEWEST_WINDOWS or not white > 0:
        return OrderNoise()
    beside = np.array([_coefficients(phase - phase[0], rest, turns, bins) for phase, rest in windows[first:]])
    begin = np.exp(1j * np.array([phase[0] for phase, _ in windows[first:]]))[:, None]
    beside -= _leaked(np.gradient(vectors)[first:, None] * begin, turns, np.array(bins))
    levels = np.maximum(np.median(np.abs(beside) ** 2, axis=0), 1e-300) / _OF_MEDIAN
    level, scatter = _at_order(np.array(bins) / turns, levels, len(beside))
    above = level - math.log(2 * white**2)
    if above < _SURE * scatter:
        return OrderNoise()
    scaled = beside / np.sqrt(levels)
    turned = scaled / begin
    parts = np.median(np.real(turned) ** 2), np.median(np.imag(turned) ** 2)
    real, imaginary = (math.sqrt(math.exp(above) * 2 * float(part) / float(sum(parts))) for part in parts)
    return OrderNoise(max(1.0, real), max(1.0, imaginary), _neighbours(scaled))


def _coefficients(phase: Array, rest: Array, turns: int, bins: Sequence[int]) -> Complex:
    """2/n Σ r e^{−ikψ/m} of each bin, shape (bins,)."""
    step = np.exp(-1j / turns * phase)
    wave = step ** bins[0]
    found = np.empty(len(bins), np.complex128)
    for j, k in enumerate(bins):
        wave = wave * step ** (k - bins[j - 1]) if j else wave
        found[j] = 2 * (wave @ rest) / len(rest)
    return found


def _leaked(change: Complex, turns: int, bins: NDArray[np.int_]) -> Complex:
    """What a vector that changes by Δ along a window leaves beside the order, shape (windows, bins).

    Δ/(2πi(m−k)) − Δ*/(2πi(m+k)), the coefficients of Re(Δ(u − ½) e^{2πimu}), u from 0 to 1.

    Args:
        change: Δ, where ψ counts from the window's start, shape (windows, 1).
    """
    return np.asarray((change / (turns - bins) - np.conj(change) / (turns + bins)) / (2j * math.pi), np.complex128)


def _at_order(order: Array, levels: Array, windows: int) -> tuple[float, float]:
    """Logarithm of the level at order 1 by a power law through those beside it, and its standard deviation."""
    design = np.stack([np.ones_like(order), np.log(order)], axis=1)
    normal = np.linalg.inv(design.T @ design)
    level, slope = normal @ design.T @ np.log(levels)
    scatter = _LOG_SCATTER * math.sqrt(float(normal[0, 0]) / windows)
    if abs(slope) > _STEEPEST:
        level = float(np.mean(np.log(levels) - math.copysign(_STEEPEST, slope) * design[:, 1]))
    return float(level), scatter


def _neighbours(scaled: Complex) -> float:
    """Correlation of a coefficient with that of the next window; 0 unless above chance.

    One below 0 would make a mean's errors cancel; a beat of hum with the windows looks like that for a while.
    """
    products = np.real(np.conj(scaled[:-1]) * scaled[1:])
    found = float(products.sum() / np.sum(np.abs(scaled) ** 2)) * len(scaled) / (len(scaled) - 1)
    return min(found, _MOST_CORRELATED) if found > _SURE / math.sqrt(2 * products.size) else 0.0
