"""Common methods for a free decay in plain form; they share no code with this package's estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, signal as scipy_signal

from identification.bench.decays import DecayTrial
from identification.bench.trials import MethodResult
from rig_basics.texts import number_of

Array = NDArray[np.floating]
_linalg, _optimize, _signal = cast("Any", linalg), cast("Any", optimize), cast("Any", scipy_signal)  # untyped in scipy
Reading = Callable[[Array, Array], tuple[float, float]]
"""Maps times and values of one sensor to f in Hz and ζ."""

_FLOOR = 0.2  # share of the amplitude at which the careful methods end
_POLES_HZ = 50.0  # rate of the block averages for the matrix pencil: at least 4 samples per cycle of the fastest mode


def log_decrement(record: DecayTrial) -> MethodResult:
    """Fit a line to the logarithms of all maxima against their numbers, as in textbooks."""
    return _each_channel(record, lambda t, y: _log_line(t, y, *_maxima(t, y - np.mean(y))))


def careful_log_decrement(record: DecayTrial) -> MethodResult:
    """Fit a line to low-passed maxima and minima down to a fifth of the amplitude, weighted by the amplitude."""

    def channel(time: Array, value: Array) -> tuple[float, float]:
        step = time[1] - time[0]
        pole = 3 * _spectral_peak(value, step)
        low_pass = _signal.butter(4, pole, fs=1 / step, output="sos")
        smooth: Array = _signal.sosfiltfilt(low_pass, value - np.mean(value[len(value) // 2 :]))
        both = [_maxima(time, sign * smooth) for sign in (1, -1)]
        at, size = (np.concatenate(parts) for parts in zip(*both, strict=True))
        order = np.argsort(at)
        at, size = at[order], size[order]
        keep = size > _FLOOR * np.max(size)
        count = len(keep) if keep.all() else max(3, int(np.argmin(keep)))
        return _log_line(time, value, at[:count], size[:count], per_cycle=2)

    return _each_channel(record, channel)


def half_power(record: DecayTrial) -> MethodResult:
    """Estimate by the peak of the spectrum and its width at 1/√2."""

    def channel(time: Array, value: Array) -> tuple[float, float]:
        step = time[1] - time[0]
        size = 8 * len(value)
        spectrum = np.abs(np.fft.rfft(value - np.mean(value), size))
        peak = int(np.argmax(spectrum))
        level = spectrum[peak] / np.sqrt(2)
        below = peak - int(np.argmax(spectrum[peak::-1] < level))
        above = peak + int(np.argmax(spectrum[peak:] < level))
        grid = 1 / (size * step)
        return peak * grid, (above - below) / (2 * peak)

    return _each_channel(record, channel)


def hilbert_envelope(record: DecayTrial) -> MethodResult:
    """Estimate by lines through phase and logarithm of the band-passed analytic signal."""

    def channel(time: Array, value: Array) -> tuple[float, float]:
        step = time[1] - time[0]
        frequency = _spectral_peak(value, step)
        band = _signal.butter(2, [0.6 * frequency, 1.4 * frequency], "bandpass", fs=1 / step, output="sos")
        analytic = np.asarray(_signal.hilbert(_signal.sosfiltfilt(band, value)))
        size = np.abs(analytic)
        edge = round(1.0 / (frequency * step))
        first = edge
        low = np.flatnonzero(size[first:] < _FLOOR * size[first])
        last = min(len(size) - edge, first + int(low[0]) if len(low) else len(size))
        cut = slice(first, last)
        decay = -np.polyfit(time[cut], np.log(size[cut]), 1)[0]
        wave = np.polyfit(time[cut], np.unwrap(np.angle(analytic[cut])), 1)[0]
        return _of_rate(complex(-decay, wave))

    return _each_channel(record, channel)


def matrix_pencil(record: DecayTrial) -> MethodResult:
    """Estimate poles by the shift of the signal space of a Hankel matrix of block averages (ERA, HTLS)."""
    return answer_of_poles(_poles(record))


def nonlinear_least_squares(record: DecayTrial) -> MethodResult:
    """Estimate by scipy's least_squares on all samples, started by the matrix pencil, intervals from its Jacobian."""
    modes = [_of_rate(pole) for pole in _poles(record)]
    signals = record.displacement_m.reshape(len(record.time_s), -1)
    channels = signals.shape[1]
    start = np.array([part for mode in modes for part in mode])
    linear = np.linalg.lstsq(_waves(start, record.time_s), signals, rcond=None)[0]

    def residual(theta: Array) -> Array:
        fitted = _waves(theta[: len(start)], record.time_s) @ theta[len(start) :].reshape(-1, channels)
        return (fitted - signals).ravel()

    def jacobian(theta: Array) -> Array:
        waves, columns = _waves(theta[: len(start)], record.time_s), list[Array]()
        coefficients = theta[len(start) :].reshape(-1, channels)
        for j in range(len(start)):
            moved = theta[: len(start)].copy()
            h = 1e-6 * abs(moved[j])
            moved[j] += h
            columns.append(((_waves(moved, record.time_s) - waves) / h @ coefficients).ravel())
        return np.column_stack([*columns, np.kron(waves, np.eye(channels))])

    scale = np.concatenate([np.abs(start) * 1e-2, np.full(linear.size, 1e-4)])
    first = np.concatenate([start, linear.ravel()])
    found = _optimize.least_squares(residual, first, jacobian, method="lm", x_scale=scale)
    jac = cast(Array, found.jac)
    covariance = np.linalg.inv(jac.T @ jac) * (2 * float(found.cost) / (signals.size - len(first)))
    values: dict[str, float] = dict(zip(_names(len(modes)), found.x[: len(start)].tolist(), strict=True))
    std = np.sqrt(np.diag(covariance))
    spans = {n: (v - 1.96 * s, v + 1.96 * s) for (n, v), s in zip(values.items(), std, strict=False)}
    return MethodResult(values, spans)


def _waves(theta: Array, time: Array) -> Array:
    """Return cosine and sine part of every mode and a constant, shape (n, 2 m + 1)."""
    columns: list[Array] = []
    for frequency, zeta in theta.reshape(-1, 2):
        omega = 2 * np.pi * frequency
        wave = np.exp(omega * (-zeta + 1j * np.sqrt(1 - zeta * zeta + 0j)) * time)
        columns += [wave.real, wave.imag]
    return np.column_stack([*columns, np.ones_like(time)])


def block_means(record: DecayTrial, rate_Hz: float = _POLES_HZ) -> tuple[float, Array]:
    """Return the step and the means over blocks, shape (n, channels), which have the same poles and less noise."""
    step = float(record.time_s[1] - record.time_s[0])
    width = max(1, round(1 / (rate_Hz * step)))
    signals = record.displacement_m.reshape(len(record.time_s), -1)
    count = len(signals) // width
    return width * step, signals[: count * width].reshape(count, width, -1).mean(axis=1)


def _poles(record: DecayTrial) -> list[complex]:
    """Return continuous poles with positive frequency, as many as channels, in order of frequency."""
    step, means = block_means(record)
    count, channels = means.shape
    rows = count // 3
    order = 2 * channels + 1  # a pair for each mode, one for the offset
    space: Array = np.concatenate([_linalg.hankel(m[:rows], m[rows - 1 :]) for m in means.T])
    top = len(space) - 1
    found: Array = _linalg.eigh(space @ space.T, subset_by_index=[top - order + 1, top])[1]
    vectors = found.reshape(channels, rows, -1)
    early, late = vectors[:, :-1].reshape(-1, order), vectors[:, 1:].reshape(-1, order)
    poles = np.log(np.linalg.eigvals(np.linalg.lstsq(early, late, rcond=None)[0]).astype(complex)) / step
    return strongest(poles, channels)


def strongest(poles: Array, wanted: int, lowest_Hz: float = 0.5) -> list[complex]:
    """Return the wanted number of least damped poles above a frequency, in order of frequency.

    Raises:
        ValueError: there are fewer such poles.
    """
    found = sorted((complex(p) for p in poles if p.imag > 2 * np.pi * lowest_Hz), key=lambda p: -p.real)[:wanted]
    if len(found) < wanted:
        raise ValueError(f"expected {number_of(wanted, 'oscillating pole')} above {lowest_Hz:g} Hz, found {len(found)}")
    return sorted(found, key=abs)


def answer_of_poles(poles: Sequence[complex]) -> MethodResult:
    """Return f and ζ of continuous poles, numbered in their order."""
    parts = [part for pole in poles for part in _of_rate(pole)]
    return MethodResult(dict(zip(_names(len(poles)), parts, strict=True)))


def _names(modes: int) -> list[str]:
    return [name for i in range(1, modes + 1) for name in (f"f{i}_Hz", f"zeta{i}")]


def _of_rate(pole: complex) -> tuple[float, float]:
    """Return f in Hz and ζ of a continuous pole."""
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


def _each_channel(record: DecayTrial, channel: Reading) -> MethodResult:
    """Apply a one-mode method to each sensor separately: sensor x is mode 1, sensor y mode 2."""
    signals = record.displacement_m.reshape(len(record.time_s), -1)
    parts = [part for signal in signals.T for part in channel(record.time_s, signal)]
    return MethodResult(dict(zip(_names(signals.shape[1]), (float(p) for p in parts), strict=True)))


def _spectral_peak(value: Array, step: float) -> float:
    spectrum = np.abs(np.fft.rfft(value - np.mean(value)))
    return float(np.argmax(spectrum) / (len(value) * step))


def _maxima(time: Array, value: Array) -> tuple[Array, Array]:
    """Return times and heights of the maxima, at least 0.7 of a cycle apart."""
    step = time[1] - time[0]
    apart = max(1, round(0.7 / (_spectral_peak(value, step) * step)))
    at: NDArray[np.int64] = _signal.find_peaks(value, height=0, distance=apart)[0]
    return time[at], value[at]


def _log_line(time: Array, value: Array, at: Array, size: Array, per_cycle: int = 1) -> tuple[float, float]:
    """Return f and ζ from lines through the logarithms of the extremes and through their times."""
    weight = size if per_cycle > 1 else None
    number = np.arange(len(at))
    decay = -np.polyfit(at, np.log(size), 1, w=weight)[0]
    period = np.polyfit(number, at, 1, w=weight)[0] * per_cycle
    return _of_rate(complex(-decay, 2 * np.pi / period))
