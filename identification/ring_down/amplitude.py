"""Dependence of damping and frequency on amplitude: one mode in windows of decreasing amplitude.

The other mode and the drift are those of the whole fit. In each window, amplitude, phase, ω and ζ of the mode are
estimated by one Gauss–Newton step. A straight line is fitted to ω and ζ over the amplitude of the windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from identification.colour import Colour
from identification.ring_down.backbone import REFERENCE_M, averaged_course, course
from identification.ring_down.decay import FittedDecay
from identification.ring_down.modes import averaged_decay, damping_derivative, rate
from identification.samples import Averages

_WINDOWS, _MIN_CYCLES = 6, 3.0
_MIN_SIGNAL_TO_NOISE = 6.0  # amplitude in a window over its standard deviation
_MIN_SIGNIFICANCE = 3.9  # standard deviations, p = 1e-4


@dataclass(frozen=True)
class AmplitudeDependence:
    """Rates of one mode over its amplitude.

    Attributes:
        mode: 1 or 2.
        amplitude_m: mean amplitude of each window, m, shape (n,), decreasing.
        zeta, zeta_std: damping ratio in each window and its standard deviation, shape (n,).
        f_Hz, f_std_Hz: natural frequency in each window and its standard deviation, Hz, shape (n,).
        zeta_slope_per_m, zeta_slope_std: slope of the straight line through ζ and its standard deviation, 1/m.
        f_slope_Hz_per_m, f_slope_std: slope of the straight line through f and its standard deviation, Hz/m.
    """

    mode: int
    amplitude_m: np.ndarray
    zeta: np.ndarray
    zeta_std: np.ndarray
    f_Hz: np.ndarray
    f_std_Hz: np.ndarray
    zeta_slope_per_m: float
    zeta_slope_std: float
    f_slope_Hz_per_m: float
    f_slope_std: float

    @property
    def zeta_matters(self) -> bool:
        """Whether ζ changes significantly with amplitude (p < 1e-4)."""
        return abs(self.zeta_slope_per_m) > _MIN_SIGNIFICANCE * self.zeta_slope_std

    @property
    def f_matters(self) -> bool:
        """Whether f changes significantly with amplitude (p < 1e-4)."""
        return abs(self.f_slope_Hz_per_m) > _MIN_SIGNIFICANCE * self.f_slope_std

    @property
    def zeta_range(self) -> float:
        """Change of ζ along the line over the windows."""
        return abs(self.zeta_slope_per_m) * float(np.ptp(self.amplitude_m))

    @property
    def f_range_Hz(self) -> float:
        """Change of f along the line over the windows, Hz."""
        return abs(self.f_slope_Hz_per_m) * float(np.ptp(self.amplitude_m))


def amplitude_dependence(
    fitted: FittedDecay, mode: int, stretch: float = 1.0, whole: bool = True
) -> AmplitudeDependence | None:
    """Analyse a mode in windows of decreasing amplitude, in the channel with the largest amplitude over noise.

    Args:
        fitted: solved fit.
        mode: 0 or 1.
        stretch: factor on standard deviations for noise above white noise.
        whole: whether the rates include the fitted terms of amplitude; otherwise only the remaining change.
    Returns:
        None for fewer than three windows.
    """
    channel, t, residual, amplitude, colour, record = _clearest(fitted, mode)
    omega, zeta = float(fitted.omegas[mode]), float(fitted.zetas[mode])
    lam = rate(omega, zeta)
    wave, slope, level_of, zeta_of, omega_of = _course(fitted, record, mode, t, channel)
    columns = (
        np.column_stack(
            [
                np.real(wave),
                -np.imag(wave),
                (lam * amplitude * slope).real,
                (damping_derivative(omega, zeta) * amplitude * slope).real,
            ]
        )
        * channel.weight[:, None]
    )
    columns = columns if colour is None else colour.whitened(columns)
    rows: list[tuple[float, ...]] = []
    for first, last in _windows(t, channel, abs(amplitude), lam):
        own = columns[first:last]
        scale = np.sqrt(np.sum(own**2, axis=0))
        inverse = cast(NDArray[np.float64], np.linalg.pinv((own / scale).T @ (own / scale), rcond=1e-12))
        moved = inverse @ ((own / scale).T @ residual[first:last]) / scale
        std = np.sqrt(np.diag(inverse)) / scale * stretch
        level = abs(amplitude) * float(np.mean(level_of[first:last]))
        own_zeta = float(np.mean(zeta_of[first:last])) if whole else zeta
        own_omega = float(np.mean(omega_of[first:last])) if whole else omega
        rows.append((level, own_zeta + moved[3], std[3], own_omega + omega * moved[2], omega * std[2]))
    if len(rows) < 3:
        return None
    level, zetas, zeta_std, omegas, omega_std = np.array(rows).T
    f, f_std = omegas / (2 * np.pi), omega_std / (2 * np.pi)
    return AmplitudeDependence(
        mode + 1, level, zetas, zeta_std, f, f_std, *_line(level, zetas, zeta_std), *_line(level, f, f_std)
    )


def _course(
    fitted: FittedDecay, record: int, mode: int, t: np.ndarray, channel: Averages
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Wave of a mode, its derivative by λ, relative amplitude, ζ and ω over time; shape (n,) each."""
    model, rates = fitted.model, fitted.model.mode_rates(fitted.theta, mode)
    lam = rate(rates.omega, rates.zeta)
    if model.backbone is None:
        wave, slope = averaged_decay(lam, t, channel.spread_s2)
        alike = np.ones_like(t)
        return wave, slope, np.exp(lam.real * t), rates.zeta * alike, rates.omega * alike
    start = model.backbone.amplitudes_m[record][mode]
    wave, _ = averaged_course(rates, start, t, channel.spread_s2)
    share = np.exp(course(rates, start, t).power.real)
    level = start * share / REFERENCE_M
    return wave, wave * t, share, rates.zeta + rates.drag * level, rates.omega * (1 + rates.hardening * level**2)


def _clearest(fitted: FittedDecay, mode: int) -> tuple[Averages, np.ndarray, np.ndarray, complex, Colour | None, int]:
    """Channel with the largest amplitude over noise: blocks, times, residual, amplitude, colour and record."""
    best = (-1.0, 0, 0, 0j)
    for r, record in enumerate(fitted.model.records):
        for axis, channel in enumerate(record.channels):
            amplitude = fitted.amplitude(r, axis, mode)
            if abs(amplitude) / channel.noise > best[0]:
                best = (abs(amplitude) / channel.noise, r, axis, amplitude)
    _, r, axis, amplitude = best
    record = fitted.model.records[r]
    colour = record.colours[axis] if record.colours else None
    return record.channels[axis], record.times[axis], fitted.channel_residuals()[r][axis], amplitude, colour, r


def _windows(t: np.ndarray, channel: Averages, amplitude: float, lam: complex) -> list[tuple[int, int]]:
    """Index ranges of equal ratios of amplitude, from the start until the mode falls below the noise."""
    decay, cycle = max(-lam.real, 1e-9), 2 * np.pi / lam.imag
    per_second = float(np.sum(channel.count)) / float(t[-1] - t[0])
    floor = _MIN_SIGNAL_TO_NOISE * channel.noise / np.sqrt(per_second * max(_MIN_CYCLES * cycle, 0.5 / decay))
    end = min(float(t[-1]), max(np.log(max(amplitude / floor, 1.0)) / decay, 0.0))
    length = max(end / _WINDOWS, _MIN_CYCLES * cycle)
    edges = np.searchsorted(t, np.arange(0.0, end + 1e-9, length))
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= 16]


def _line(x: np.ndarray, y: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Slope of a weighted straight line and its std, widened if the scatter of the points exceeds their std."""
    w = 1 / std**2
    centre = float(w @ x / w.sum())
    spread = float(w @ (x - centre) ** 2)
    slope = float(w @ ((x - centre) * y) / spread)
    left = y - w @ y / w.sum() - slope * (x - centre)
    chi2 = float(w @ left**2) / max(len(x) - 2, 1)
    return slope, float(np.sqrt(max(1.0, chi2) / spread))
