"""Does damping or frequency depend on amplitude? One mode looked at in windows of falling amplitude.

The other mode and the drift are taken from the whole fit; in each window the mode's own amplitude, phase, ω and ζ are
fitted anew by one Gauss–Newton step, and a straight line is laid through ω and ζ over the window's amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identification.colour import Colour
from identification.ring_down.backbone import REFERENCE_M, averaged_course, course
from identification.ring_down.decay import Fitted
from identification.ring_down.modes import averaged_decay, damping_derivative, rate
from identification.samples import Averages

_WINDOWS, _LEAST_CYCLES = 6, 3.0
_ABOVE_NOISE = 6.0  # a window's amplitude against the std that its amplitude is known to
_SIGNIFICANT = 3.9  # p = 1e-4


@dataclass(frozen=True)
class AmplitudeDependence:
    """One mode over its amplitude.

    Attributes:
        mode: 1 or 2.
        amplitude_m: mean amplitude of each window, shape (n,), falling.
        zeta, zeta_std: damping ratio in each window, shape (n,).
        f_Hz, f_std_Hz: natural frequency in each window, shape (n,).
        zeta_slope_per_m, zeta_slope_std: of the straight line through ζ.
        f_slope_Hz_per_m, f_slope_std: of the straight line through f.
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
        """Whether ζ certainly changes with amplitude (p < 1e-4)."""
        return abs(self.zeta_slope_per_m) > _SIGNIFICANT * self.zeta_slope_std

    @property
    def f_matters(self) -> bool:
        """Whether f certainly changes with amplitude (p < 1e-4)."""
        return abs(self.f_slope_Hz_per_m) > _SIGNIFICANT * self.f_slope_std

    @property
    def zeta_range(self) -> float:
        """How far ζ changes along the line over the windows."""
        return abs(self.zeta_slope_per_m) * float(np.ptp(self.amplitude_m))

    @property
    def f_range_Hz(self) -> float:
        """How far f changes along the line over the windows."""
        return abs(self.f_slope_Hz_per_m) * float(np.ptp(self.amplitude_m))


def amplitude_dependence(
    fitted: Fitted, mode: int, stretch: float = 1.0, whole: bool = True
) -> AmplitudeDependence | None:
    """A mode in windows of falling amplitude, from the channel that shows it best; None with fewer than three windows.

    Args:
        mode: 0 or 1.
        stretch: noise above white, as a factor of standard deviations.
        whole: with what the fit's own terms of amplitude explain; otherwise what is left beyond them.
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
    rows = []
    for first, last in _windows(t, channel, abs(amplitude), lam):
        own = columns[first:last]
        scale = np.sqrt(np.sum(own**2, axis=0))
        inverse = np.linalg.pinv((own / scale).T @ (own / scale), rcond=1e-12)
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
    fitted: Fitted, record: int, mode: int, t: np.ndarray, channel: Averages
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mode's wave, its slope by λ, its amplitude over that at the begin, ζ and ω over time; shape (n,) each."""
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


def _clearest(fitted: Fitted, mode: int) -> tuple[Averages, np.ndarray, np.ndarray, complex, Colour | None, int]:
    """A mode's clearest channel: blocks, times, residual, amplitude, colour and record."""
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
    """Index ranges of equal drops in amplitude, from the start to where the mode sinks into the noise."""
    decay, cycle = max(-lam.real, 1e-9), 2 * np.pi / lam.imag
    per_second = float(np.sum(channel.count)) / float(t[-1] - t[0])
    floor = _ABOVE_NOISE * channel.noise / np.sqrt(per_second * max(_LEAST_CYCLES * cycle, 0.5 / decay))
    end = min(float(t[-1]), max(np.log(max(amplitude / floor, 1.0)) / decay, 0.0))
    length = max(end / _WINDOWS, _LEAST_CYCLES * cycle)
    edges = np.searchsorted(t, np.arange(0.0, end + 1e-9, length))
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= 16]


def _line(x: np.ndarray, y: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Slope of a weighted straight line and its std, stretched where the points scatter beyond theirs."""
    w = 1 / std**2
    centre = float(w @ x / w.sum())
    spread = float(w @ (x - centre) ** 2)
    slope = float(w @ ((x - centre) * y) / spread)
    left = y - w @ y / w.sum() - slope * (x - centre)
    chi2 = float(w @ left**2) / max(len(x) - 2, 1)
    return slope, float(np.sqrt(max(1.0, chi2) / spread))
