"""Start values for a passage without prior information and without sweep bias.

Let X and P be the Fourier transforms of a signal and of the real or imaginary part of e^{iψ}. The response of
oscillators with the common denominator D(s) = sⁿ + d_{n−1} s^{n−1} + … to a rotating imbalance is

    D(s) X = −s² Σ N(s) P + E(s),        s = iw,

where E contains the motion before and after the record. The equation is linear in D, N and E. A few iterations with the
weight 1/|D| remove the weighting that results from the multiplication by D. The equation is valid for any sweep rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from identification.errors import NotIdentifiable
from identification.run_up.forced_oscillator import Excitation, responses_of
from identification.samples import Averages

_SAMPLES_PER_TURN = 16
_ROUNDS = 8
_THINNED = 4  # every fourth block is sufficient to compare start values
_MAX_UNEXPLAINED = 0.03  # share of the power, and
_MAX_CHI2 = 1.5  # χ² per block, up to which the search ends
_BEYOND = (1.06, 1.2, 1.5, 2.0, 2.7, 4.0)  # frequencies of a resonance that is not passed, over the fastest speed
_BEYOND_ZETA = 0.02
_FINER = (0.08, 0.025, 0.008)  # relative steps around the best of them, two to either side


@dataclass(frozen=True)
class RunUpStart:
    """Start values of a fit.

    Attributes:
        omegas, zetas: natural frequencies, rad/s, and damping ratios of the directions closest to x and to y.
        angle_rad: angle between stiffness axes and sensors, rad.
        cost: squared residual per block in standard deviations, with all linear unknowns free in both sensors.
    """

    omegas: tuple[float, float]
    zetas: tuple[float, float]
    angle_rad: float
    cost: float

    @property
    def alike(self) -> bool:
        """Whether both directions share one resonance."""
        return self.omegas[0] == self.omegas[1]


def run_up_starts(channels: Sequence[Averages], drive: Excitation, thorough: bool = False) -> list[RunUpStart]:
    """Return start values from several denominators, best first.

    Args:
        channels: block averages of both sensors.
        drive: drive.
        thorough: whether other resonances are searched even if the common resonances of both sensors explain the
            signals.
    Raises:
        NotIdentifiable: neither sensor shows a resonance.
    """
    spectra = _Spectra.of(channels, drive)
    thinned = [c.where(np.arange(len(c.time_s)) % _THINNED == 0) for c in channels]
    power = float(np.mean([float(np.mean(((c.value - np.mean(c.value)) * c.weight) ** 2)) for c in thinned]))
    starts = [_assigned(thinned, drive, pair) for pair in [spectra.modes([0, 1], 2)] if len(pair) == 2]
    single = spectra.modes([0, 1], 1)
    pairs = [[mode, mode] for mode in single]
    if thorough or not starts or starts[0].cost > min(_MAX_CHI2, _MAX_UNEXPLAINED * power):
        alone = [spectra.modes([i], 1) for i in (0, 1)]
        pairs += [[a, b] for a in alone[0] for b in alone[1]]
        unexplained = thorough or not starts or starts[0].cost > _MAX_UNEXPLAINED * power
        # the tail of a distant resonance looks like a lag of the sensors, which only the fit contains
        beyond = _beyond(thinned, drive, list(dict.fromkeys((*single, *alone[0], *alone[1]))))
        starts += [s for s in beyond if unexplained or s.cost < _MAX_CHI2]
    starts += [_assigned(thinned, drive, pair) for pair in pairs]
    if not starts:
        raise NotIdentifiable("neither sensor shows a resonance in this record; does the speed pass one?")
    return sorted(starts, key=lambda s: s.cost)


@dataclass(frozen=True)
class _Spectra:
    """Spectra of signals and drive at the frequencies of the passed speeds; s in units of scale."""

    s: np.ndarray
    scale: float
    signals: list[np.ndarray]
    phasor: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, channels: Sequence[Averages], drive: Excitation) -> _Spectra:
        step = 2 * np.pi / drive.top_rad_s / _SAMPLES_PER_TURN
        start = max(drive.start_s, *(c.time_s[0] for c in channels))
        end = min(drive.end_s, *(c.time_s[-1] for c in channels))
        t = np.arange(start, end, step)
        w = 2 * np.pi * np.fft.rfftfreq(len(t), step)
        band = (w > max(0.3 * drive.low_rad_s, 0.1 * drive.top_rad_s)) & (w < 1.15 * drive.top_rad_s)
        if np.count_nonzero(band) < 30:
            raise NotIdentifiable("the run-up is too short to contain a resonance")
        psi = drive.history.phase(t)[:, 0]
        signals = [np.fft.rfft(np.interp(t, c.time_s, c.value) - np.mean(c.value))[band] / c.noise for c in channels]
        scale = 0.5 * drive.top_rad_s
        phasor = tuple(np.fft.rfft(f(psi))[band] for f in (np.cos, np.sin))
        return cls(1j * w[band] / scale, scale, signals, (phasor[0], phasor[1]))

    def modes(self, sensors: list[int], count: int) -> list[tuple[float, float]]:
        """(ω, ζ) of up to `count` resonances that are common to some sensors."""
        order = 2 * count
        powers = self.s[:, None] ** np.arange(order + 1)
        weight = 1 / np.abs(powers[:, order])
        denominator = np.zeros(order)
        for _ in range(_ROUNDS):
            normal, right = np.zeros((order, order)), np.zeros(order)
            for i in sensors:
                signal = self.signals[i][:, None] * powers
                force = [self.s[:, None] ** 2 * p[:, None] * powers[:, : order - 1] for p in self.phasor]
                own = _real(np.column_stack([*force, powers[:, :order]]) * weight[:, None])
                shared = _real(signal * weight[:, None])
                q, _ = np.linalg.qr(own / (np.linalg.norm(own, axis=0) + 1e-300))
                shared -= q @ (q.T @ shared)
                normal += shared[:, :order].T @ shared[:, :order]
                right -= shared[:, :order].T @ shared[:, order]
            size = np.sqrt(np.diag(normal)) + 1e-300
            denominator = np.linalg.lstsq(normal / np.outer(size, size), right / size, rcond=1e-14)[0] / size
            weight = 1 / np.maximum(np.abs(powers[:, order] + powers[:, :order] @ denominator), 1e-6)
        roots = np.roots([1.0, *denominator[::-1]]) * self.scale
        roots = roots[roots.imag > 1e-3 * self.scale]
        # a slightly negative damping is a small one with an estimation error
        return [(float(abs(r)), float(np.clip(-r.real / abs(r), 3e-4, 0.6))) for r in roots]


def _beyond(channels: Sequence[Averages], drive: Excitation, modes: list[tuple[float, float]]) -> list[RunUpStart]:
    """Start values with a second resonance above the passed speeds, at its best frequency; empty without modes.

    Such a resonance changes the signal of its sensor only slightly and determines its frequency roughly. Speed ripple
    may pass it at half its frequency, which causes a narrow minimum within a wide one. The frequency is therefore
    searched in successively finer steps.
    """

    def at(mode: tuple[float, float], omega: float) -> tuple[RunUpStart, float, tuple[float, float]]:
        return _assigned(channels, drive, [mode, (omega, _BEYOND_ZETA)]), omega, mode

    if not modes:
        return []
    best = min((at(mode, 1.5 * drive.top_rad_s) for mode in modes), key=lambda tried: tried[0].cost)
    best = min((at(best[2], ratio * drive.top_rad_s) for ratio in _BEYOND), key=lambda tried: tried[0].cost)
    for step in _FINER:
        nearby = [at(best[2], best[1] * (1 + k * step)) for k in (-2, -1, 1, 2)]
        best = min((best, *nearby), key=lambda tried: tried[0].cost)
    return [best[0]]


def _real(columns: np.ndarray) -> np.ndarray:
    return np.concatenate([np.real(columns), np.imag(columns)])


def _assigned(channels: Sequence[Averages], drive: Excitation, pair: Sequence[tuple[float, float]]) -> RunUpStart:
    """Assign two resonances to the directions, and estimate the angle between axes and sensors.

    The signal of each sensor is fitted as a free sum of both responses. For x = cos β Re(A h1) + sin β Im(A h2) and its
    turned counterpart, the ratios of the coefficients are ∓i tan β.
    """
    cost, count, parts = 0.0, 0, list[complex]()
    sensors = responses_of([(c.time_s, c.spread_s2) for c in channels], drive, list(dict.fromkeys(pair)))
    for channel, answers in zip(channels, sensors, strict=True):
        since = channel.time_s - drive.start_s
        columns: list[np.ndarray] = []
        for seen in answers:
            columns += [np.real(seen.h), -np.imag(seen.h), np.real(seen.decay), -np.imag(seen.decay)]
        basis = np.column_stack([*columns, np.ones_like(since), since]) * channel.weight[:, None]
        size = np.linalg.norm(basis, axis=0) + 1e-300
        normal = (basis / size).T @ (basis / size)
        right = (basis / size).T @ (channel.value * channel.weight)
        scaled = cast(NDArray[np.float64], np.linalg.lstsq(normal, right, rcond=1e-13)[0])
        c = scaled / size
        residual = channel.value * channel.weight - basis @ c
        cost, count = cost + float(residual @ residual), count + len(residual)
        parts.append(complex(c[0], c[1]))
        parts.append(complex(c[4], c[5]) if len(columns) == 8 else 0j)
    (omega_a, zeta_a), (omega_b, zeta_b) = pair
    x_a, x_b, y_a, y_b = parts
    if pair[0] == pair[1]:
        return RunUpStart((omega_a, omega_a), (zeta_a, zeta_a), 0.0, cost / count)
    if abs(x_b) * abs(y_a) > abs(x_a) * abs(y_b):
        omega_a, omega_b, zeta_a, zeta_b = omega_b, omega_a, zeta_b, zeta_a
        x_a, x_b, y_a, y_b = x_b, x_a, y_b, y_a
    tangents = [(1j * x_b / x_a).real if x_a else 0.0, (1j * y_a / y_b).real if y_b else 0.0]
    # the sensor with the smaller ratio shows its own resonance better
    angle = float(np.arctan(min(tangents, key=abs)))
    return RunUpStart((omega_a, omega_b), (zeta_a, zeta_b), angle, cost / count)
