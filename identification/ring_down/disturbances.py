"""Disturbances in a ring-down's record: lines, other oscillations, and coloured noise.

A fitted mode that does not decay is a line. A narrow peak in the spectrum of the residuals is a line if it does not
decay, and another oscillation if it does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from identification.colour import Colour, colour_of
from identification.least_squares import solve_separable
from identification.lines import MAX_LINE_DAMPING, SpectralLine, local_level, smooth_window, steady_lines
from identification.ring_down.decay import DecayData, FittedDecay
from identification.ring_down.model import DecayModel, DecayRecord
from identification.ring_down.modes import averaged_decay, rate
from identification.ring_down.record import SensorRecord
from identification.ring_down.residuals import gain_of
from identification.samples import Averages
from identification.typed_scipy import next_fast_len

_MAX_STEADY_STD, _MIN_DECAY_STD = 3.0, 4.0  # standard deviations of ζ
_MAX_DECAY_STD = 0.15  # standard deviation of the decay over the record; above it, a peak is not classified
SMALL = 0.25  # of the strongest mode's amplitude; larger oscillations that do not decay are not removed
_MAX_WEAK_RATIO = 0.5  # of the stronger mode's amplitude
_FOREIGN_GAIN = 60.0  # of χ² by an independent amplitude in the other sensor
_MIN_MISFIT_STD = 6.0  # standard deviations of χ²/dof
_MIN_ACROSS = 0.2  # of a mode's amplitude; above the effect of sensors 5° out of square and of crosstalk
_MIN_VALUES, _MIN_POWER_RATIO = 200, 40.0  # number of values; power of a peak over its local level
_OWN_BAND, _LOBE = 3.0, 4.0  # half-bandwidths, and ordinates, next to a mode in which a decaying peak is its misfit
_MAX_PEAKS, _MAX_ZETA = 3, 0.1
_MIN_AMPLITUDE = 2e-5  # of a mode's amplitude
_MAX_CHANGE = 0.25  # of a line's amplitude from the middle of the record to its end
_SAME_Hz = 0.3  # frequencies closer than this belong to the same line
_SECONDS_PER_ORDER = 2.0  # of a record per order of a varying line's polynomial


def without_lines(channel: SensorRecord) -> SensorRecord:
    """Return a channel with the steady lines outside the peaks of its motion subtracted."""
    lines = steady_lines(channel.time_s, channel.value_m, channel.keep)
    return channel.without(lines) if lines else channel


@dataclass(frozen=True)
class ResidualOscillation:
    """Oscillation in the residuals.

    Attributes:
        lam: complex rate, 1/s.
        line: whether it does not decay, or belongs to a known line.
        near: whether a mode is so close that only a fit of both can decide.
    """

    lam: complex
    line: bool
    near: bool = False


def steady_mode(fitted: FittedDecay) -> int | None:
    """Index of a fitted mode that does not decay and is therefore a line; None if all modes decay."""
    if not np.all(np.isfinite(fitted.theta)):
        return None
    stds = np.sqrt(np.diag(fitted.solution.minimum.covariance)) * np.sqrt(max(1.0, fitted.solution.chi2_per_dof))
    span = min(float(t[-1]) for record in fitted.model.records for t in record.times)
    sizes = [mode_size(fitted, m) for m in range(fitted.model.modes)]
    for m in np.argsort(sizes):
        zeta, std, omega = float(fitted.zetas[m]), float(stds[2 * m + 1]), float(fitted.omegas[m])
        small = sizes[int(m)] < SMALL * max(sizes)
        margin = _MAX_STEADY_STD * std
        if zeta + margin < MAX_LINE_DAMPING and (small or abs(zeta) < MAX_LINE_DAMPING + margin):
            return int(m)
        if small and zeta < margin and std * omega * span < _MAX_DECAY_STD:
            return int(m)
    return None


def foreign_mode(fitted: FittedDecay) -> int | None:
    """Index of a turned pair's weaker mode if it moves in another direction, or phase, than the model; else None.

    A mode of the suspension moves along a straight line perpendicular to that of the other mode. The oscillation of a
    floor or a cable does not: it has an independent amplitude in the other sensor. The gain of that amplitude is
    tested.
    """
    model = fitted.model
    if not model.turned or not np.all(np.isfinite(fitted.theta)):
        return None
    sizes = [mode_size(fitted, m) for m in range(2)]
    weak = int(np.argmin(sizes))
    lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    apart = abs(lams[0] - lams[1]) > _OWN_BAND * max(abs(lam.real) for lam in lams)
    if sizes[weak] > _MAX_WEAK_RATIO * sizes[1 - weak] or not apart:
        return None
    noise, across = max(1.0, fitted.solution.chi2_per_dof), 1 - weak
    if noise < 1 + _MIN_MISFIT_STD * np.sqrt(2 / fitted.count):
        return None
    for r, (record, block, c) in enumerate(
        zip(model.records, model(fitted.theta), fitted.solution.coefficients, strict=True)
    ):
        parts = [np.zeros((len(t), 2)) for t in record.times]
        wave, _ = averaged_decay(lams[weak], record.times[across], record.channels[across].spread_s2)
        parts[across] = np.column_stack([np.real(wave), -np.imag(wave)])
        extra = record.scaled(np.concatenate(parts))
        known, residual = np.column_stack([block.basis, block.tangent(c)]), block.data - block.basis @ c
        columns = np.column_stack([known, extra])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        found = cast(NDArray[np.float64], np.linalg.lstsq(columns / scale, residual, rcond=1e-12)[0])
        own = float(np.hypot(*(found / scale)[-2:]))
        gain = gain_of(residual, known, extra) / noise
        if gain > _FOREIGN_GAIN and own > _MIN_ACROSS * abs(fitted.amplitude(r, weak, weak)):
            return weak
    return None


def mode_size(fitted: FittedDecay, mode: int) -> float:
    """Largest amplitude of a mode in any sensor, m."""
    return max(
        abs(fitted.amplitude(r, axis, mode))
        for r, record in enumerate(fitted.model.records)
        for axis in range(len(record.channels))
    )


def without_mode(fitted: FittedDecay, mode: int) -> DecayData:
    """Return the decay with a fitted mode subtracted, as a line or as another decaying oscillation."""
    frequency = float(fitted.omegas[mode]) / (2 * np.pi)
    decay = float(fitted.zetas[mode] * fitted.omegas[mode]) if mode != steady_mode(fitted) else 0.0

    def change(r: int, axis: int, channel: SensorRecord) -> SensorRecord:
        amplitude = fitted.amplitude(r, axis, mode)
        return channel.without([SpectralLine(frequency, amplitude, fitted.model.records[r].zero_s, decay)])

    return fitted.decay.with_channels(change)


def other_oscillation(fitted: FittedDecay) -> ResidualOscillation | None:
    """Strongest oscillation in the residuals that does not belong to a mode, or None."""
    peaks: list[tuple[float, float]] = []
    for record, residuals in zip(fitted.model.records, fitted.plain_residuals(), strict=True):
        for t, residual in zip(record.times, residuals, strict=True):
            peaks += _peaks(t, residual)
    for _, frequency in sorted(peaks, reverse=True)[:_MAX_PEAKS]:
        other = _refined(fitted, frequency)
        if other is not None:
            return other
    return None


def _peaks(t: np.ndarray, residual: np.ndarray) -> list[tuple[float, float]]:
    """Narrow peaks of a channel's residuals: power over the local level, and frequency, Hz."""
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1] + 0.5 * step, step)
    if len(grid) < _MIN_VALUES:
        return []
    even = np.interp(grid, t, residual) if len(grid) != len(t) else residual
    size = next_fast_len(len(even))
    power = np.abs(np.fft.rfft((even - even.mean()) * smooth_window(len(even)), size)) ** 2
    prominence = power[1:-1] / np.maximum(local_level(power)[1:-1], 1e-300)
    frequency = np.arange(1, len(power) - 1) / (size * step)
    top = (prominence > _MIN_POWER_RATIO) & (power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])
    top &= frequency > 6 / (grid[-1] - grid[0])
    return list(zip(prominence[top].tolist(), frequency[top].tolist(), strict=True))


def _refined(fitted: FittedDecay, frequency: float) -> ResidualOscillation | None:  # noqa: PLR0911  # one exit per criterion
    """Oscillation at a peak of the residuals; None if it may be the misfit of a mode."""
    rest = _residual_model(fitted)
    start = np.array([np.log(2 * np.pi * frequency), 0.0])
    solution = solve_separable(rest, start, np.zeros(2), np.full(2, np.inf), 20)
    omega, zeta = float(np.exp(solution.minimum.theta[0])), float(solution.minimum.theta[1])
    span = min(float(t[-1]) for record in rest.records for t in record.times)
    if not np.isfinite(omega) or abs(omega / (2 * np.pi) - frequency) > max(2 / span, 0.02 * frequency):
        return None
    if any(
        abs(line.frequency_Hz - frequency) < _SAME_Hz for own in fitted.decay.records for c in own for line in c.lines
    ):
        return ResidualOscillation(complex(0.0, omega), True)
    channels = [(k, i) for k, r in enumerate(rest.records) for i in range(len(r.channels))]
    sizes = [float(np.hypot(*solution.coefficients[k][2 * i : 2 * i + 2])) for k, i in channels]
    if max(sizes) < _MIN_AMPLITUDE * max(mode_size(fitted, m) for m in range(fitted.model.modes)):
        return None
    std = float(np.sqrt(solution.minimum.covariance[1, 1] * max(1.0, solution.chi2_per_dof)))
    if abs(zeta) < max(_MAX_STEADY_STD * std, MAX_LINE_DAMPING):
        # if a misfit makes the decay uncertain, and in a mode's own band, a fit of both decides
        vague = std * omega * span > _MAX_DECAY_STD
        return ResidualOscillation(complex(0.0, omega), True, vague or _in_own_band(fitted, 1j * omega, span))
    if zeta < 0:
        return ResidualOscillation(complex(0.0, omega), True, True)  # a mode that decays earlier contains a part of it
    lam = rate(omega, zeta)
    if _in_own_band(fitted, lam, span):
        return ResidualOscillation(complex(0.0, omega), True, True)
    return ResidualOscillation(lam, False) if _MIN_DECAY_STD * std < zeta < _MAX_ZETA else None


def _in_own_band(fitted: FittedDecay, lam: complex, span_s: float) -> bool:
    """Whether a rate is so close to that of a mode that it may be the mode's misfit."""
    modes = [rate(float(omega), float(zeta)) for omega, zeta in zip(fitted.omegas, fitted.zetas, strict=True)]
    lobe = 2 * np.pi * _LOBE / span_s
    return any(abs(lam - mode) < max(_OWN_BAND * max(-mode.real, -lam.real), lobe) for mode in modes)


def _residual_model(fitted: FittedDecay) -> DecayModel:
    """Model of one free oscillation in every channel of the residuals."""
    records: list[DecayRecord] = []
    for record, residuals in zip(fitted.model.records, fitted.plain_residuals(), strict=True):
        channels = tuple(replace(c, value=own) for c, own in zip(record.channels, residuals, strict=True))
        records.append(DecayRecord(channels, record.zero_s))
    return DecayModel(tuple(records), 1, False, 0, False, fitted.width_s)


def without_other(fitted: FittedDecay, other: ResidualOscillation) -> DecayData:
    """Return the decay with an oscillation subtracted. A known line gets a polynomial of higher order instead."""
    frequency = other.lam.imag / (2 * np.pi)
    rests = fitted.plain_residuals()

    def change(r: int, axis: int, channel: SensorRecord) -> SensorRecord:
        near = [line for line in channel.lines if abs(line.frequency_Hz - frequency) < _SAME_Hz]
        record = fitted.model.records[r]
        t = record.times[axis]
        if near:
            order = min(max(4, 2 * near[0].order, round(float(t[-1]) / _SECONDS_PER_ORDER)), 40)
            wandering = replace(near[0], order=order)
            return replace(channel, lines=tuple(wandering if line is near[0] else line for line in channel.lines))
        wave, _ = averaged_decay(other.lam, t, record.channels[axis].spread_s2)
        basis = np.column_stack([np.real(wave), -np.imag(wave)])
        c, *_ = np.linalg.lstsq(basis, rests[r][axis], rcond=None)
        return channel.without([SpectralLine(frequency, complex(c[0], c[1]), record.zero_s, -other.lam.real)])

    return fitted.decay.with_channels(change)


def stays(fitted: FittedDecay, frequency_Hz: float) -> bool:
    """Whether a fitted line has a constant amplitude over the record, in the channel with its largest amplitude."""
    best = (0.0, np.inf)
    for record, channels, c in zip(
        fitted.model.records, fitted.decay.records, fitted.solution.coefficients, strict=True
    ):
        at = len(c) - len(record.channels) * (fitted.model.drift + 1) - record.line_columns.shape[1]
        for channel, means in zip(channels, record.channels, strict=True):
            for line in channel.lines:
                if not channel.in_blocks(line, fitted.width_s):
                    continue
                order = line.order + 1
                first = line.amplitude_m * np.exp(line.rate * (float(means.time_s[0]) - line.zero_s))
                size = complex(first + complex(c[at], -c[at + order]))
                slope = complex(c[at + 1], -c[at + order + 1])
                if abs(line.frequency_Hz - frequency_Hz) < 1e-6 * frequency_Hz and size:
                    best = max(best, (abs(size), abs((slope / size).real)))
                at += 2 * order
    return best[1] < _MAX_CHANGE


def coloured(fitted: FittedDecay) -> DecayData | None:
    """Return the decay with the colours of its noise; None if all noise is white."""
    modes = [(w / (2 * np.pi), z * w / (2 * np.pi)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    found: dict[tuple[int, int], Colour] = {}
    for r, residuals in enumerate(fitted.plain_residuals()):
        for axis, residual in enumerate(residuals):
            channel, means = fitted.decay.records[r][axis], fitted.model.records[r].channels[axis]
            own = colour_of(residual * np.sqrt(means.count) / channel.noise, channel.noise, fitted.width_s, modes)
            if own is not None:
                found[r, axis] = own
    if not found and not any(c.colour for channels in fitted.decay.records for c in channels):
        return None
    return fitted.decay.with_channels(lambda r, axis, channel: replace(channel, colour=found.get((r, axis))))


def is_disturbed(fitted: FittedDecay) -> bool:
    """Whether lines or coloured noise were found in any channel."""
    return any(c.lines or c.colour is not None for channels in fitted.decay.records for c in channels)


def white_rests(fitted: FittedDecay) -> list[list[Averages]]:
    """Whitened residuals of a fit as block averages, [record][channel]."""
    return [
        [replace(c, value=own / c.weight) for c, own in zip(record.channels, residuals, strict=True)]
        for record, residuals in zip(fitted.model.records, fitted.channel_residuals(), strict=True)
    ]
