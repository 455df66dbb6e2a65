"""Half-power and Vold–Kalman estimates for comparison with the fit. Both treat the passage as a steady state.

Both are biased by the sweep. The comparison shows the size of the bias.
"""

from __future__ import annotations

import numpy as np

from dynamics.equations.speed_history import SpeedHistory
from identification.least_squares import minimise
from identification.samples import Averages
from identification.typed_scipy import gaussian_filter1d, solveh_banded

_SMOOTHED_S = 0.25  # standard deviation of the Gaussian filter
_VOLD_KALMAN_HZ = 0.5  # half-power bandwidth of the filter
_MAX_POINTS = 400


def half_power(channel: Averages, history: SpeedHistory) -> tuple[float, float]:
    """Frequency and damping ratio from the peak and its width at 1/√2.

    Returns:
        f in Hz and ζ; NaN if the curve does not fall below 1/√2 on both sides.
    """
    psi, speed, _ = history.phase(channel.time_s).T
    speed = np.abs(speed)
    step = float(np.median(np.diff(channel.time_s)))
    order = 2 * gaussian_filter1d(
        (channel.value - np.mean(channel.value)) * np.exp(-1j * psi), _SMOOTHED_S / step, truncate=2.5
    )
    size = np.abs(order)
    peak = int(np.argmax(size))
    before = np.flatnonzero(size[:peak] < size[peak] / np.sqrt(2))
    after = np.flatnonzero(size[peak:] < size[peak] / np.sqrt(2))
    if len(before) == 0 or len(after) == 0:
        return float("nan"), float("nan")
    width = abs(speed[peak + after[0]] - speed[before[-1]])
    return float(speed[peak] / (2 * np.pi)), float(width / (2 * speed[peak]))


def vold_kalman(channel: Averages, history: SpeedHistory) -> tuple[float, float]:
    """Frequency and damping ratio of a steady-state resonance curve through the first order's Vold–Kalman amplitude.

    The second-generation filter with two poles yields the complex amplitude a that minimises
    Σ|2 y e^{−iψ} − a|² + r² Σ|∇² a|². |a| ∝ Ω² / |ω² − Ω² + 2iζωΩ| is then fitted over the speeds.

    Returns:
        f in Hz and ζ; NaN if no such curve fits.
    """
    psi, speed, _ = history.phase(channel.time_s).T
    speed = np.abs(speed)
    size = np.abs(_envelope(channel, psi))
    every = max(1, len(size) // _MAX_POINTS)
    inside = slice(len(size) // 50, -len(size) // 50, every)
    speed, size = speed[inside], size[inside]
    unit = 0.01 * float(size.max())
    if unit == 0.0:
        return float("nan"), float("nan")

    def evaluate(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        w, z, a = np.exp(np.clip(p, -30.0, 30.0))
        detune, width = w * w - speed**2, 2 * z * w * speed
        square = detune**2 + width**2 + 1e-300
        curve = a * speed**2 / np.sqrt(square)
        by_w = -curve * (2 * detune * w * w + width**2) / square
        return (curve - size) / unit, np.column_stack([by_w, -curve * width**2 / square, curve]) / unit

    peak = int(np.argmax(size / np.maximum(speed, 0.1 * speed.max()) ** 2))
    starts = [np.log([speed[peak], z, 2 * z * float(size[peak])]) for z in (0.02, 0.2)]
    found = min((minimise(evaluate, s) for s in starts), key=lambda m: m.cost)
    w, z, _ = np.exp(np.clip(found.theta, -30.0, 30.0))
    good = found.converged and 0.3 * speed.min() < w < 3 * speed.max() and 1e-5 < z < 2
    return (float(w / (2 * np.pi)), float(z)) if good else (float("nan"), float("nan"))


def _envelope(channel: Averages, psi: np.ndarray) -> np.ndarray:
    """Complex amplitude of the first order at the blocks, shape (n,), m."""
    n = len(psi)
    step = float(np.median(np.diff(channel.time_s)))
    # 1/(1 + r² (w·step)⁴)² is one half at half the bandwidth
    r2 = (np.sqrt(2) - 1) / (np.pi * _VOLD_KALMAN_HZ * step) ** 4
    bands = np.zeros((3, n))
    bands[2] = 6.0
    bands[2, [0, -1]], bands[2, [1, -2]] = 1.0, 5.0
    bands[1, 1:] = -4.0
    bands[1, [1, -1]] = -2.0
    bands[0, 2:] = 1.0
    bands *= r2
    bands[2] += 1.0
    turned = 2 * (channel.value - np.mean(channel.value)) * np.exp(-1j * psi)
    return solveh_banded(bands, np.asarray(turned, np.complex128))
