"""Decaying oscillations: complex rates, their averages over blocks, the damped periodogram.

A mode of natural frequency ω and damping ratio ζ is Re(a e^{λt}) with λ = −ζω + iω sqrt(1 − ζ²).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.samples import Averages


def rate(omega: float, zeta: float) -> complex:
    """λ in 1/s."""
    return omega * complex(-zeta, np.sqrt(max(1 - zeta * zeta, 1e-12)))


def rate_derivatives(omega: float, zeta: float) -> tuple[complex, complex]:
    """∂λ/∂ln ω and ∂λ/∂ln ζ."""
    return rate(omega, zeta), zeta * damping_derivative(omega, zeta)


def damping_derivative(omega: float, zeta: float) -> complex:
    """∂λ/∂ζ, which also holds at and below ζ = 0."""
    return omega * complex(-1.0, -zeta / np.sqrt(max(1 - zeta * zeta, 1e-12)))


def averaged_decay(lam: complex, time_s: np.ndarray, spread_s2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """e^{λt} averaged over blocks, and its derivative with respect to λ; complex, shape (n,)."""
    wave = np.exp(lam * time_s)
    curved = 1 + 0.5 * spread_s2 * lam * lam
    return wave * curved, wave * (time_s * curved + spread_s2 * lam)


_GAPPY = 0.9  # share of the blocks that hold samples
_COVERED = 0.97
_TOGETHER = 2**16  # numbers transformed at a time
_FEW_CYCLES = 0.05  # decay over frequency: three cycles until e⁻¹

# least frequency over decay: a gap in the first cycle is strong at low frequencies and hides what oscillates
_OSCILLATES = (0.0, 2.0, 5.0)


@dataclass(frozen=True)
class Start:
    """A mode to begin with.

    Attributes:
        omega, zeta: rad/s and dimensionless.
        share: part of the signals' energy that the mode explains, 0 to 1.
    """

    omega: float
    zeta: float
    share: float

    @property
    def lam(self) -> complex:
        """λ in 1/s."""
        return rate(self.omega, self.zeta)

    @staticmethod
    def at(lam: complex, share: float = 0.0) -> Start:
        """The mode with rate λ."""
        return Start(abs(lam), -lam.real / abs(lam), share)


def damped_periodogram(records: Sequence[Sequence[Averages]], lowest_Hz: float = 0.3) -> Start:
    """The decaying sinusoid that explains most of some channels together.

    S(f, d) = |Σ y e^{−dt} e^{−iωt}|² / Σ e^{−2dt} is the energy that a decay rate d explains; one FFT per d. Channels
    count by their weight, each with its own amplitude and phase; a record's channels start together.

    Args:
        records: block averages from the release on; gaps count as zero signal.
    """
    channels = [(channel, record[0].time_s[0]) for record in records for channel in record]
    longest = max(float(c.time_s[-1] - zero) for c, zero in channels)
    step = max(float(np.median(np.diff(c.time_s))) for c, _ in channels)
    n = round(longest / step) + 1
    grids = np.array([_on_grid(channel, zero, step, n) for channel, zero in channels])
    total = max(float(np.sum(grids**2)), 1e-300)
    decays = np.geomspace(0.2 / longest, min(0.05 / step, 60.0), 24)
    peaks = [peak for batch in _batches(decays, n, step, len(grids)) for peak in _peaks(grids, batch, step, lowest_Hz)]
    power, lam = max(peaks, key=lambda peak: peak[0])
    share = min(1.0, 2 * power / total)
    if -lam.real > _FEW_CYCLES * lam.imag and _covered(channels, -6 / lam.real, step) < _COVERED:
        # a gap as zeros takes much of few cycles: what each rate leaves of the samples there are decides
        few = [peak for _, peak in peaks if -peak.real > 0.3 * _FEW_CYCLES * peak.imag]
        lam = _most_explained(channels, list(dict.fromkeys(few)))
    sampled = sum(len(c.time_s) for c, _ in channels) / (len(channels) * n)
    if sampled < _GAPPY:
        # a motion cut off at the rail leaves pieces around its zero crossings, whose harmonics are strong
        lam = _most_explained(channels, [complex(lam.real, lam.imag / k) for k in (1, 2, 3)])
    return Start.at(lam, share)


def _batches(decays: np.ndarray, n: int, step: float, channels: int) -> list[tuple[int, list[tuple[float, int]]]]:
    """Decay rates whose transforms have the same size, some at a time: that size, and each rate with its samples.

    Two transforms made together are quicker than one after the other; many leave the processor's cache.
    """
    out: list[tuple[int, list[tuple[float, int]]]] = []
    for decay in decays.tolist():
        used = min(n, int(12 / (decay * step)) + 8)  # beyond, the window is 1e-5
        size = 1 << int(np.ceil(np.log2(max(2 * used, 512))))
        if out and out[-1][0] == size and (len(out[-1][1]) + 1) * channels * size <= _TOGETHER:
            out[-1][1].append((decay, used))
        else:
            out.append((size, [(decay, used)]))
    return out


def _peaks(
    grids: np.ndarray, batch: tuple[int, list[tuple[float, int]]], step: float, lowest_Hz: float
) -> list[tuple[float, complex]]:
    """The energy that each decay rate of a batch explains at best, and its λ, for each least frequency over decay."""
    size, rates = batch
    most, peaks = max(used for _, used in rates), []
    time = np.arange(most) * step
    windowed, energy = np.zeros((len(rates), len(grids), most)), []
    for row, (decay, used) in zip(windowed, rates, strict=True):
        window = np.exp(-decay * time[:used])
        energy.append(float(window @ window))
        np.multiply(grids[:, :used], window, out=row[:, :used])
    lowest = int(np.ceil(lowest_Hz * size * step))
    for spectrum, own, (decay, _) in zip(np.fft.rfft(windowed, size), energy, rates, strict=True):
        power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
        power[:lowest] = 0.0
        for least in _OSCILLATES:
            first = min(int(least * decay / (2 * np.pi) * size * step), len(power) - 1)
            k = first + int(np.argmax(power[first:]))
            peaks.append((float(power[k]) / own, complex(-decay, 2 * np.pi * k / (size * step))))
    return peaks


def _covered(channels: Sequence[tuple[Averages, float]], span_s: float, step: float) -> float:
    """Share of the blocks at the beginning that hold samples, in the channel that has fewest."""
    shares = []
    for channel, zero in channels:
        last = min(span_s, float(channel.time_s[-1]) - zero)
        shares.append(np.searchsorted(channel.time_s, zero + last) * step / max(last, step))
    return float(min(shares))


def _most_explained(channels: Sequence[tuple[Averages, float]], lams: Sequence[complex]) -> complex:
    """Which rate explains most of what was sampled; gaps count as gaps."""
    left = []
    for lam in lams:
        rests = [without_modes(channel, [lam], zero) for channel, zero in channels]
        left.append(sum(float(np.sum((rest.value * rest.weight) ** 2)) for rest in rests))
    return lams[int(np.argmin(left))]


def _on_grid(channel: Averages, zero_s: float, step: float, n: int) -> np.ndarray:
    """A channel's weighted deviations from its rest on a uniform grid, shape (n,)."""
    t = channel.time_s - zero_s
    at = np.clip(np.round(t / step).astype(int), 0, n - 1)
    out = np.zeros(n)
    out[at] = (channel.value - np.mean(channel.value[len(t) // 2 :])) / channel.noise
    return out


def without_modes(channel: Averages, lams: Sequence[complex], zero_s: float) -> Averages:
    """The channel with some modes and an offset regressed out."""
    t = channel.time_s - zero_s
    waves = [averaged_decay(lam, t, channel.spread_s2)[0] for lam in lams]
    basis = np.column_stack([*(part for wave in waves for part in (np.real(wave), np.imag(wave))), np.ones_like(t)])
    fitted = basis @ np.linalg.lstsq(basis, channel.value, rcond=None)[0]
    return Averages(channel.time_s, channel.spread_s2, channel.value - fitted, channel.count, channel.noise)
