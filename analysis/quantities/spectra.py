"""Spectra with calibrated units: power density, amplitudes, and the full spectrum of an orbit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.times import checked_times


@dataclass(frozen=True)
class Spectrum(Tabular):
    """A spectrum.

    Attributes:
        frequency_Hz: frequencies, shape (n,); negative ones of a full spectrum are backward.
        values: amplitudes of lines in m, or one-sided power density in m²/Hz.
        resolution_Hz: equivalent noise bandwidth of the window.
        averages: number of windows.
    """

    frequency_Hz: Array
    values: Array
    resolution_Hz: float
    averages: int

    @property
    def heading(self) -> str:
        """Resolution and number of windows."""
        return f"Spectrum: resolution {self.resolution_Hz:.4g} Hz, {number_of(self.averages, 'window')}"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each frequency."""
        return {"frequency_Hz": self.frequency_Hz, "values": self.values}


def power_density(time_s: ArrayLike, displacement_m: ArrayLike, *, window_s: float | None = None) -> Spectrum:
    """Return the one-sided power density, m²/Hz, by Welch's method with half-overlapping windows.

    Its integral over frequency is the variance of the signal.

    Args:
        time_s, displacement_m: samples, shapes (n,); gaps and NaN shorter than two samples are interpolated linearly,
            windows with longer gaps are left out.
        window_s: length of a window; by default an eighth of the record.
    Raises:
        ValueError: shapes differ, times are dates or run backwards, or no window is complete.
    """
    values, rate, whole = _even(time_s, displacement_m)
    length = _length(len(values), rate, window_s)
    kept = [values[a : a + length] for a in _starts(whole, length)]
    if not kept:
        raise ValueError(f"spectrum: no window of {length / rate:.3g} s without a gap in {len(values) / rate:.3g} s")
    window = _hann(length)
    density = np.zeros(length // 2 + 1)
    for part in kept:
        density += np.abs(np.fft.rfft(window * (part - part.mean()))) ** 2
    density *= 2.0 / (rate * float(window @ window) * len(kept))
    density[0] *= 0.5
    if length % 2 == 0:
        density[-1] *= 0.5
    return Spectrum(
        np.arange(length // 2 + 1, dtype=np.float64) * (rate / length), density, 1.5 * rate / length, len(kept)
    )


def amplitude_spectrum(time_s: ArrayLike, displacement_m: ArrayLike, *, window_s: float | None = None) -> Spectrum:
    """Return amplitudes of lines, m: a sine of 1 mm yields 1 mm (a Hann window loses 15 % half a bin off its bin).

    Arguments and errors as for `power_density`.

    Example:
        >>> import numpy as np
        >>> from analysis import amplitude_spectrum
        >>> time = np.arange(0.0, 10.0, 1e-3)
        >>> found = amplitude_spectrum(time, 2e-3 * np.sin(2 * np.pi * 12 * time))
        >>> largest = found.values.argmax()
        >>> print(f"{1e3 * found.values[largest]:.3f} mm at {found.frequency_Hz[largest]:.2f} Hz")
        2.000 mm at 12.00 Hz
    """
    density = power_density(time_s, displacement_m, window_s=window_s)
    lines = np.sqrt(2 * density.values * density.resolution_Hz)
    return Spectrum(density.frequency_Hz, lines, density.resolution_Hz, density.averages)


def full_spectrum(time_s: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, *, window_s: float | None = None) -> Spectrum:
    """Return amplitudes of x + i y over signed frequency, m: positive frequencies turn from x to y.

    A circular orbit of radius 1 mm yields 1 mm on one side and 0 on the other.

    Args:
        time_s, x_m, y_m: samples at the same times, shapes (n,).
    Source: Goldman and Muszynska, Application of full spectrum to rotating machinery diagnostics, Orbit 1999.
    """
    x, rate, whole_x = _even(time_s, x_m)
    y, _, whole_y = _even(time_s, y_m)
    length = _length(len(x), rate, window_s)
    window = _hann(length)
    power = np.zeros(length)
    starts = _starts(whole_x & whole_y, length)
    if not starts:
        raise ValueError(f"spectrum: no window of {length / rate:.3g} s without a gap in {len(x) / rate:.3g} s")
    for a in starts:
        part = x[a : a + length] + 1j * y[a : a + length]
        power += np.abs(np.fft.fft(window * (part - part.mean()))) ** 2
    amplitude = np.sqrt(power / len(starts)) / window.sum()
    frequency = (np.arange(length, dtype=np.float64) - length // 2) * (rate / length)
    return Spectrum(frequency, np.fft.fftshift(amplitude), 1.5 * rate / length, len(starts))


def _even(time_s: ArrayLike, values: ArrayLike) -> tuple[Array, float, NDArray[np.bool_]]:
    """Return samples at even times, their rate, and whether each is measured rather than interpolated."""
    time, signal = checked_times(time_s, ValueError), np.asarray(values, np.float64)
    if time.shape != signal.shape or time.ndim != 1:
        raise ValueError(f"spectrum: time and displacement must be alike, got {time.shape} and {signal.shape}")
    good = np.isfinite(signal) & np.isfinite(time)
    if good.sum() < 16:
        raise ValueError(f"spectrum: expected at least 16 valid samples, got {int(good.sum())}")
    step = float(np.median(np.diff(time)))
    count = int((time[good][-1] - time[good][0]) / step + 1e-6) + 1
    even: Array = time[good][0] + step * np.arange(count)
    after = np.minimum(np.searchsorted(time[good], even), int(good.sum()) - 1)
    gap = time[good][after] - time[good][np.maximum(after - 1, 0)]
    return np.interp(even, time[good], signal[good]), 1 / step, gap < 2.5 * step


def _hann(length: int) -> Array:
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)


def _length(count: int, rate: float, window_s: float | None) -> int:
    wanted = count // 8 if window_s is None else round(window_s * rate)
    return min(max(16, wanted), count)


def _starts(whole: NDArray[np.bool_], length: int) -> list[int]:
    """Return the starts of half-overlapping windows without a gap."""
    lost = np.concatenate([[0], np.cumsum(~whole)])
    return [a for a in range(0, len(whole) - length + 1, max(1, length // 2)) if lost[a + length] == lost[a]]
