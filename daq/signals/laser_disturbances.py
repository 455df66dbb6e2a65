"""Disturbances of a laser in addition to the rotor's motion: wander of its zero, and steady lines.

Both are searched in the residual of a displacement after the motion is removed. Wander is power below 1 Hz far above
the level of white noise; the suspension has no mode there. A line is a narrow peak whose amplitude is constant over the
record; a ring-down decays.
Source: docs/theory/detection_of_steady_states.md, "Noise that is not white".
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rig_basics.arrays import Array

BELOW_Hz: Final = 1.0
# Samples are thinned to an even grid of at most this rate.
_MAX_RATE_Hz = 1000.0
MIN_LENGTH_S = 6.0
_MIN_ORDINATES = 5
# Wander is this many times the white level: a misfit or a changing orbit leaves several times that level.
_MIN_WANDER_RATIO = 30.0
_FIRST_ORDINATE = 1.5  # ordinates below are removed by the taper and the straight line
_GROUP = 24  # ordinates whose median is the local level
_MIN_PEAK_RATIO = 60.0  # power over that level; the maximum of 10⁵ ordinates of noise stays below 17
_MIN_DEVIATIONS = 12.0  # standard deviations of a line's amplitude
# The amplitudes of a steady line in both halves of a record differ by at most this share.
_MAX_CHANGE = 0.25
_SEPARATION = 4.0  # ordinates from a line or an order to another
_MAX_LINES, _MAX_PEAKS = 4, 20
_MAINS_Hz = (50.0, 60.0)


@dataclass(frozen=True)
class Wander:
    """Slow noise of a laser.

    Attributes:
        rms_m: rms of the part below 1 Hz, m.
        slope: α of a spectrum like 1/f^α below 1 Hz.
    """

    rms_m: float
    slope: float

    @property
    def words(self) -> str:
        """Description with figures."""
        like = "flat" if self.slope < 0.3 else "about 1/f" if self.slope < 1.5 else f"about 1/f^{self.slope:.1f}"
        return f"wanders: {1e6 * self.rms_m:.2g} µm rms below {BELOW_Hz:g} Hz, spectrum {like}"


@dataclass(frozen=True)
class SteadyLine:
    """A sinusoid that does not decay.

    Attributes:
        frequency_Hz, amplitude_m: frequency, Hz, and amplitude, m.
        phase_rad: phase of its cosine at time 0, rad.
    """

    frequency_Hz: float
    amplitude_m: float
    phase_rad: float = 0.0

    def at(self, time_s: Array) -> Array:
        """Values of the line, m."""
        return self.amplitude_m * np.cos(2 * math.pi * self.frequency_Hz * time_s + self.phase_rad)

    @property
    def words(self) -> str:
        """Description with figures and a possible cause."""
        figures = f"{self.frequency_Hz:.2f} Hz, {1e6 * self.amplitude_m:.3g} µm"
        for mains in _MAINS_Hz:
            times = round(self.frequency_Hz / mains)
            if times and abs(self.frequency_Hz - times * mains) < 0.002 * self.frequency_Hz + 0.02:
                return f"{figures}: mains hum?"
        return figures


def wander_in(time_s: Array, residual_m: Array, white_m2_per_Hz: float) -> Wander | None:
    """Return slow noise far above the white part; None if it is not present or the record is short.

    Args:
        time_s: shape (n,), ascending, s.
        residual_m: residual after the motion is removed, shape (n,), m; finite.
        white_m2_per_Hz: one-sided level of the white noise, 2σ²Δt.
    """
    if len(time_s) < 2 or time_s[-1] - time_s[0] < MIN_LENGTH_S or not white_m2_per_Hz > 0:
        return None
    time, even = thinned(time_s, residual_m)
    step_s = float(time[1] - time[0])
    length_s = step_s * len(even)
    from_middle = np.linspace(-1.0, 1.0, len(even))
    straight = np.polynomial.polynomial.polyfit(from_middle, even, 1)
    taper = np.hanning(len(even))
    spectrum = np.fft.rfft((even - straight[0] - straight[1] * from_middle) * taper)
    power = np.abs(spectrum) ** 2 * 2 * step_s / float(taper @ taper)
    frequency = np.arange(len(power)) / length_s
    slow = (frequency >= _FIRST_ORDINATE / length_s) & (frequency <= BELOW_Hz)
    if slow.sum() < _MIN_ORDINATES or float(np.median(power[slow])) < _MIN_WANDER_RATIO * math.log(2) * white_m2_per_Hz:
        return None
    line = np.polynomial.polynomial.polyfit(np.log(frequency[slow]), np.log(np.maximum(power[slow], 1e-300)), 1)
    lacking = BELOW_Hz / (BELOW_Hz - _FIRST_ORDINATE / length_s)  # assumes the same density below the first one
    rms = math.sqrt(float(power[slow].sum()) / length_s * lacking)
    return Wander(rms, max(0.0, -float(line[1])))


def lines_in(
    time_s: Array,
    value_m: Array,
    residual: tuple[Array, Array],
    known_Hz: Sequence[tuple[float, float]] = (),
    least_m: float = 0.0,
) -> list[SteadyLine]:
    """Return the significant steady lines, strongest first.

    Args:
        time_s, value_m: samples, shape (n,), ascending, finite; s and m. They give the line's amplitude, and reject
            aliases of the thinned samples.
        residual: times and residuals after the motion is removed, thinned, shapes (k,).
        known_Hz: frequencies and half-widths of bands that may contain residuals of the motion.
        least_m: smallest amplitude of a reported line, m.
    """
    length = float(residual[0][-1] - residual[0][0]) if len(residual[0]) > 1 else 0.0
    if length < MIN_LENGTH_S:
        return []
    found: list[SteadyLine] = []
    apart = _SEPARATION / length
    for frequency, noise in _peaks(*residual):
        near = [*known_Hz, *((line.frequency_Hz, 0.0) for line in found)]
        if frequency < max(BELOW_Hz, 2 * apart) or any(abs(frequency - f) < apart + wide for f, wide in near):
            continue
        line = _steady(time_s, value_m, frequency, noise)
        if line is not None and line.amplitude_m >= least_m:
            found.append(line)
        if len(found) == _MAX_LINES:
            break
    return found


def _peaks(time_s: Array, residual_m: Array) -> Iterator[tuple[float, float]]:
    """Yield the frequencies of narrow peaks, strongest first, with the noise of the amplitude in half a record, m."""
    step = float(time_s[1] - time_s[0])
    window = np.hanning(len(residual_m))
    power = np.abs(np.fft.rfft((residual_m - residual_m.mean()) * window)) ** 2
    count = len(power) // _GROUP
    if count < 2:
        return
    local = np.median(power[: count * _GROUP].reshape(count, _GROUP), axis=1)
    level = np.concatenate([np.repeat(local, _GROUP), np.full(len(power) - count * _GROUP, local[-1])])
    inner = power[1:-1]
    top = 1 + np.flatnonzero((inner > power[:-2]) & (inner >= power[2:]) & (inner > _MIN_PEAK_RATIO * level[1:-1]))
    for k in top[np.argsort(power[top])[::-1]][:_MAX_PEAKS]:
        noise = 2 * math.sqrt(2 * float(level[k]) / math.log(2) / 2) / float(window.sum())
        yield _peak(power, int(k)) / (step * len(residual_m)), noise


def sentences(name: str, wander: Wander | None, lines: Sequence[SteadyLine]) -> list[str]:
    """Return sentences on the disturbances of a laser; empty if none was found.

    Args:
        name: name of the laser, such as "laser x".
    """
    found = [f"{name} {wander.words}"] if wander is not None else []
    if lines:
        found.append(
            f"{name} shows {'a steady line' if len(lines) == 1 else 'steady lines'} at "
            f"{'; '.join(line.words for line in lines)}"
        )
    return found


def thinned(time_s: Array, value: Array) -> tuple[Array, Array]:
    """Return times and values of a record on an even grid of at most about 1 kHz; each value is a mean."""
    step = float(np.median(np.diff(time_s)))
    grid: Array = float(time_s[0]) + step * np.arange(float(int((time_s[-1] - time_s[0]) / step + 1e-6) + 1))
    even: Array = np.asarray(np.interp(grid, time_s, value), np.float64)
    many = max(1, round(1 / (step * _MAX_RATE_Hz)))
    count = len(even) // many
    middle = grid[: count * many].reshape(count, many).mean(axis=1)
    return middle, even[: count * many].reshape(count, many).mean(axis=1)


def _peak(power: Array, k: int) -> float:
    """Position of a peak's maximum, ordinates."""
    a, b, c = np.log(np.maximum(power[k - 1 : k + 2], 1e-300))
    return k + float(0.5 * (a - c) / (a - 2 * b + c))


def _of_halves(time_s: Array, value: Array, frequency: float) -> tuple[complex, complex]:
    """Complex amplitudes, phases at time 0, in both halves of a record, each with a taper."""
    middle, reach = 0.5 * float(time_s[0] + time_s[-1]), 0.25 * float(time_s[-1] - time_s[0])
    found: list[complex] = []
    for centre in (middle - reach, middle + reach):
        first, last = np.searchsorted(time_s, [centre - reach, centre + reach])
        time, part = time_s[first:last], value[first:last]
        taper = 1 + np.cos(math.pi / reach * (time - centre))
        wave = taper * np.exp(-2j * math.pi * frequency * time)
        found.append(complex(2 * (wave @ (part - part.mean())) / taper.sum()))
    return found[0], found[1]


def _steady(time_s: Array, value: Array, frequency: float, noise: float) -> SteadyLine | None:
    """Return the line at a peak if both halves of a record show the same amplitude, far above the noise."""
    early, late = _of_halves(time_s, value, frequency)
    turned = math.remainder(cmath.phase(late) - cmath.phase(early), 2 * math.pi)
    frequency += turned / (math.pi * float(time_s[-1] - time_s[0]))
    early, late = _of_halves(time_s, value, frequency)
    size = 0.5 * (abs(early) + abs(late))
    if size < _MIN_DEVIATIONS * noise or abs(abs(early) - abs(late)) > _MAX_CHANGE * size + 4 * noise:
        return None
    return SteadyLine(frequency, abs(early + late) / 2, cmath.phase(early + late))
