"""Decaying oscillations: complex rates, averages over blocks, damped periodogram.

The motion of a mode of natural frequency ω and damping ratio ζ is Re(a e^{λt}) with λ = −ζω + iω sqrt(1 − ζ²).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.samples import Averages
from identification.work import spend


def rate(omega: float, zeta: float) -> complex:
    """Complex rate λ, 1/s."""
    return omega * complex(-zeta, np.sqrt(max(1 - zeta * zeta, 1e-12)))


def rate_derivatives(omega: float, zeta: float) -> tuple[complex, complex]:
    """∂λ/∂ln ω and ∂λ/∂ln ζ."""
    return rate(omega, zeta), zeta * damping_derivative(omega, zeta)


def damping_derivative(omega: float, zeta: float) -> complex:
    """∂λ/∂ζ, also valid for ζ ≤ 0."""
    return omega * complex(-1.0, -zeta / np.sqrt(max(1 - zeta * zeta, 1e-12)))


def averaged_decay(lam: complex, time_s: np.ndarray, spread_s2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average of e^{λt} over blocks and its derivative by λ, complex, shape (n,) each."""
    wave = np.exp(lam * time_s)
    curved = 1 + 0.5 * spread_s2 * lam * lam
    return wave * curved, wave * (time_s * curved + spread_s2 * lam)


_MIN_SAMPLED_SHARE = 0.9  # of blocks with samples in the whole record
_MIN_COVERED_SHARE = 0.97  # of blocks with samples at the start
_MAX_BATCH = 2**16  # numbers that are transformed together
_LOWEST_Hz, _LOWEST_CYCLES, _SLOWEST_Hz = 0.3, 5.0, 0.05
"""Lowest frequency of the search; cycles in the record with which a lower one is not mistaken for drift; lowest of all.

With times in milliseconds a mode of 1 to 50 Hz appears below the last one.
"""
_FEW_CYCLES = 0.05  # decay over frequency: three cycles until e⁻¹

# smallest ratios of frequency to decay: a gap in the first cycle is strong at low frequencies and hides oscillations
_MIN_FREQUENCY_RATIOS = (0.0, 2.0, 5.0)


@dataclass(frozen=True)
class Start:
    """Start values of a mode.

    Attributes:
        omega, zeta: natural frequency, rad/s, and damping ratio.
        share: share of the signals' energy that the mode explains, 0 to 1.
    """

    omega: float
    zeta: float
    share: float

    @property
    def lam(self) -> complex:
        """Complex rate λ, 1/s."""
        return rate(self.omega, self.zeta)

    @staticmethod
    def at(lam: complex, share: float = 0.0) -> Start:
        """Return the mode with the rate λ."""
        return Start(abs(lam), -lam.real / abs(lam), share)


def damped_periodogram(records: Sequence[Sequence[Averages]]) -> Start:
    """Find the decaying sinusoid that explains most energy of all channels.

    S(f, d) = |Σ y e^{−dt} e^{−iωt}|² / Σ e^{−2dt} is the energy that a decay rate d explains, with one FFT per d.
    Channels count by their weight and have their own amplitude and phase. The channels of a record start together.

    Args:
        records: block averages of each record's channels from the release on. Gaps count as zero; with many of them
            half and a third of the best frequency are compared with it.
    """
    channels = [(channel, record[0].time_s[0]) for record in records for channel in record]
    longest = max(float(c.time_s[-1] - zero) for c, zero in channels)
    step = max(float(np.median(np.diff(c.time_s))) for c, _ in channels)
    lowest_Hz = max(_SLOWEST_Hz, min(_LOWEST_Hz, _LOWEST_CYCLES / longest))
    n = round(longest / step) + 1
    grids = np.array([_on_grid(channel, zero, step, n) for channel, zero in channels])
    total = max(float(np.sum(grids**2)), 1e-300)
    decays = np.geomspace(0.2 / longest, min(0.05 / step, 60.0), 24)
    spend(len(decays) * grids.size)
    peaks = [peak for batch in _batches(decays, n, step, len(grids)) for peak in _peaks(grids, batch, step, lowest_Hz)]
    power, lam = max(peaks, key=lambda peak: peak[0])
    share = min(1.0, 2 * power / total)
    if -lam.real > _FEW_CYCLES * lam.imag and _covered(channels, -6 / lam.real, step) < _MIN_COVERED_SHARE:
        # zeros in a gap distort a decay of few cycles: the rate with the smallest residual at the samples is used
        few = [peak for _, peak in peaks if -peak.real > 0.3 * _FEW_CYCLES * peak.imag]
        lam = _most_explained(channels, list(dict.fromkeys(few)))
    sampled = sum(len(c.time_s) for c, _ in channels) / (len(channels) * n)
    if sampled < _MIN_SAMPLED_SHARE:
        # a motion cut off at the rail consists of pieces around its zero crossings, with strong harmonics
        lam = _most_explained(channels, [complex(lam.real, lam.imag / k) for k in (1, 2, 3)])
    return Start.at(lam, share)


def _batches(decays: np.ndarray, n: int, step: float, channels: int) -> list[tuple[int, list[tuple[float, int]]]]:
    """Batches of decay rates with transforms of the same size: the size, and each rate with its number of samples.

    Two transforms in one call are faster than two calls. Too many of them do not fit into the processor's cache.
    """
    out: list[tuple[int, list[tuple[float, int]]]] = []
    for decay in decays.tolist():
        used = min(n, int(12 / (decay * step)) + 8)  # beyond, the window is 1e-5
        size = 1 << int(np.ceil(np.log2(max(2 * used, 512))))
        if out and out[-1][0] == size and (len(out[-1][1]) + 1) * channels * size <= _MAX_BATCH:
            out[-1][1].append((decay, used))
        else:
            out.append((size, [(decay, used)]))
    return out


def _peaks(
    grids: np.ndarray, batch: tuple[int, list[tuple[float, int]]], step: float, lowest_Hz: float
) -> list[tuple[float, complex]]:
    """Largest energy that each decay rate of a batch explains, and its λ, for each of _MIN_FREQUENCY_RATIOS."""
    size, rates = batch
    most, peaks = max(used for _, used in rates), list[tuple[float, complex]]()
    time = np.arange(most) * step
    windowed, energy = np.zeros((len(rates), len(grids), most)), list[float]()
    for row, (decay, used) in zip(windowed, rates, strict=True):
        window = np.exp(-decay * time[:used])
        energy.append(float(window @ window))
        np.multiply(grids[:, :used], window, out=row[:, :used])
    lowest = int(np.ceil(lowest_Hz * size * step))
    for spectrum, own, (decay, _) in zip(np.fft.rfft(windowed, size), energy, rates, strict=True):
        power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
        power[:lowest] = 0.0
        for least in _MIN_FREQUENCY_RATIOS:
            first = min(int(least * decay / (2 * np.pi) * size * step), len(power) - 1)
            k = first + int(np.argmax(power[first:]))
            peaks.append((float(power[k]) / own, complex(-decay, 2 * np.pi * k / (size * step))))
    return peaks


def _covered(channels: Sequence[tuple[Averages, float]], span_s: float, step: float) -> float:
    """Share of the blocks at the start that contain samples, in the channel with the smallest share."""
    shares: list[float] = []
    for channel, zero in channels:
        last = min(span_s, float(channel.time_s[-1]) - zero)
        shares.append(np.searchsorted(channel.time_s, zero + last) * step / max(last, step))
    return float(min(shares))


def _most_explained(channels: Sequence[tuple[Averages, float]], lams: Sequence[complex]) -> complex:
    """Rate that leaves the smallest residual at the samples. Gaps do not count."""
    left: list[float] = []
    for lam in lams:
        rests = [without_modes(channel, [lam], zero) for channel, zero in channels]
        left.append(sum(float(np.sum((rest.value * rest.weight) ** 2)) for rest in rests))
    return lams[int(np.argmin(left))]


def _on_grid(channel: Averages, zero_s: float, step: float, n: int) -> np.ndarray:
    """Weighted deviations of a channel from its rest position on a uniform grid, shape (n,)."""
    t = channel.time_s - zero_s
    at = np.clip(np.round(t / step).astype(int), 0, n - 1)
    out = np.zeros(n)
    out[at] = (channel.value - np.mean(channel.value[len(t) // 2 :])) / channel.noise
    return out


def without_modes(channel: Averages, lams: Sequence[complex], zero_s: float) -> Averages:
    """Return the channel with modes and an offset removed by linear regression."""
    t = channel.time_s - zero_s
    waves = [averaged_decay(lam, t, channel.spread_s2)[0] for lam in lams]
    basis = np.column_stack([*(part for wave in waves for part in (np.real(wave), np.imag(wave))), np.ones_like(t)])
    fitted = basis @ np.linalg.lstsq(basis, channel.value, rcond=None)[0]
    return Averages(channel.time_s, channel.spread_s2, channel.value - fitted, channel.count, channel.noise)
