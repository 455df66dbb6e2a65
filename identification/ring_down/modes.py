"""Decaying oscillations: complex rates, start values from a damped periodogram.

A mode of natural frequency ω and damping ratio ζ is Re(a e^{λt}) with λ = −ζω + iω sqrt(1 − ζ²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.samples import Averages


def rate(omega: float, zeta: float) -> complex:
    """λ in 1/s."""
    return omega * complex(-zeta, np.sqrt(max(1 - zeta * zeta, 1e-12)))


def rate_derivatives(omega: float, zeta: float) -> tuple[complex, complex]:
    """∂λ/∂ln ω and ∂λ/∂ln ζ."""
    return rate(omega, zeta), omega * zeta * complex(-1.0, -zeta / np.sqrt(max(1 - zeta * zeta, 1e-12)))


def averaged_decay(lam: complex, time_s: np.ndarray, spread_s2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """e^{λt} averaged over blocks, and its derivative with respect to λ; complex, shape (n,)."""
    wave = np.exp(lam * time_s)
    curved = 1 + 0.5 * spread_s2 * lam * lam
    return wave * curved, wave * (time_s * curved + spread_s2 * lam)


@dataclass(frozen=True)
class Start:
    """A mode to begin with.

    Attributes:
        omega, zeta: rad/s and dimensionless.
        share: part of the signal's energy that the mode explains, 0 to 1.
    """

    omega: float
    zeta: float
    share: float


def damped_periodogram(channel: Averages, lowest_Hz: float = 0.3) -> Start:
    """The decaying sinusoid that explains most of a channel.

    S(f, d) = |Σ y e^{−dt} e^{−iωt}|² / Σ e^{−2dt} is the explained energy of a decay rate d; one FFT per d.

    Args:
        channel: block averages from the release on; gaps count as zero signal.
    """
    t = channel.time_s - channel.time_s[0]
    step = float(np.median(np.diff(t)))
    n = round(t[-1] / step) + 1
    grid = np.zeros(n)
    at = np.minimum(np.round(t / step).astype(int), n - 1)
    grid[at] = channel.value - np.mean(channel.value[len(t) // 2 :])
    time = np.arange(n) * step
    size = 1 << int(np.ceil(np.log2(4 * n)))
    frequency = np.fft.rfftfreq(size, step)
    allowed = frequency >= lowest_Hz
    best = (-1.0, 0.0, 0.0)
    for decay in np.geomspace(0.2 / t[-1], 0.2 / step / 4, 28):
        window = np.exp(-decay * time)
        power = np.abs(np.fft.rfft(grid * window, size)) ** 2 * allowed / np.sum(window**2)
        k = int(np.argmax(power))
        if power[k] > best[0]:
            best = (float(power[k]), float(frequency[k]), float(decay))
    wave = 2 * np.pi * best[1]
    omega = float(np.hypot(wave, best[2]))
    return Start(omega, best[2] / omega, min(1.0, 2 * best[0] / max(float(np.sum(grid**2)), 1e-300)))


def without_mode(channel: Averages, start: Start) -> Averages:
    """The channel with one mode and an offset regressed out."""
    t = channel.time_s - channel.time_s[0]
    wave, _ = averaged_decay(rate(start.omega, start.zeta), t, channel.spread_s2)
    basis = np.column_stack([np.real(wave), np.imag(wave), np.ones_like(t)])
    fitted = basis @ np.linalg.lstsq(basis, channel.value, rcond=None)[0]
    return Averages(channel.time_s, channel.spread_s2, channel.value - fitted, channel.count, channel.noise)
