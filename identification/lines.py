"""Detection of steady spectral lines in a sensor's record (mains hum, a fan, a pump) before the fit.

A line differs from a mode because it does not decay. A smooth window (Nuttall's, side lobes below 1/40 000) confines
the spectrum of a decaying motion of millimetres to a few bins. Lines of a micrometre are therefore visible in other
bands without a model of the motion. The amplitudes in five overlapping windows show whether a peak decays. A line has
amplitudes that scatter by less than a fifth, and a decay within three of its standard deviations, or ζ significantly
below 5e-5, which is required of a line above a quarter of the motion. A quiet second at the begin contains it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from dynamics.compiled_code import compiled
from identification.samples import usual_interval
from identification.typed_scipy import median_filter, next_fast_len
from rig_basics.arrays import Array

_MAX_RATE_Hz = 1000.0  # of the grid that is searched; faster records are averaged to it
_MIN_SAMPLES = 400
_LOBE_BINS = 4  # from a peak's middle to the window's first zero
_GROUP, _GROUPS = 24, 5  # bins per group, whose median is a level; groups whose levels' median bounds it from below
_MIN_POWER_RATIO = 50.0  # power of a peak over that level; in 10 000 records noise of 60 000 samples stays below 40
_MAX_LINES, _MAX_PEAKS = 12, 40
_CENTRES = (1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6)  # of the windows that measure a decay, a third of the span each
_MAX_SCATTER = 0.2  # of the logarithmic amplitudes of a steady line
_MAX_DECAY_STD = 0.15  # standard deviation of the decay over the span; above it, a peak is not classified here
MAX_LINE_DAMPING = 5e-5  # ζ: below that of any suspension, independent of the statistics
_LARGE_AMPLITUDE = 0.25  # of the largest motion
_MIN_HEAD_S = 1.0  # duration of a quiet head that shows whether a line existed before the pull
_MIN_AMPLITUDE = 1e-4  # of the largest motion: above its residue in the window's side lobes
_MAX_LISTED = 6  # lines named in a message
_NUTTALL = (0.3635819, 0.4891775, 0.1365995, 0.0106411)


@dataclass(frozen=True)
class SpectralLine:
    """Sinusoid that is not part of the motion to be identified.

    Attributes:
        frequency_Hz: apparent frequency in the samples, Hz.
        amplitude_m: complex amplitude at zero_s, m.
        zero_s: time origin, s.
        decay: decay rate, 1/s; 0 for a steady line.
        order: order of the polynomial of its complex amplitude over the record in a fit. Order 1 permits a constant
            frequency error, higher orders a varying frequency.
    """

    frequency_Hz: float
    amplitude_m: complex
    zero_s: float
    decay: float = 0.0
    order: int = 1

    @property
    def rate(self) -> complex:
        """Complex rate −decay + i 2π frequency, 1/s."""
        return complex(-self.decay, 2 * np.pi * self.frequency_Hz)

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Displacement of the line at the given times, m. A decaying line starts at zero_s."""
        since = time_s - self.zero_s
        out = (self.amplitude_m * np.exp(2j * np.pi * self.frequency_Hz * since)).real
        if self.decay == 0.0:
            return out
        return out * np.where(since >= 0, np.exp(-self.decay * np.maximum(since, 0.0)), 0.0)


@lru_cache(8)
def smooth_window(size: int) -> np.ndarray:
    """Nuttall's window over one period, shape (size,), read-only."""
    a0, a1, a2, a3 = _NUTTALL
    half = size // 2 + 1
    c = np.real(_turning(2 * np.pi / size, half))
    window = np.empty(size)
    # a0 − a1 cos x + a2 cos 2x − a3 cos 3x in powers of cos x needs one cosine instead of three; the other half is
    # the mirror image
    window[:half] = (a0 - a2) + c * ((3 * a3 - a1) + c * (2 * a2 - 4 * a3 * c))
    window[half:] = window[size - half : 0 : -1]
    window.flags.writeable = False
    return window


def _turning(angle_rad: float, count: int) -> np.ndarray:
    """Return e^{i k angle} for k = 0 … count − 1 from products of two short rows, which saves sines and cosines."""
    row = 1 << (max(count - 1, 1).bit_length() + 1) // 2
    fine, coarse = np.exp(1j * angle_rad * np.arange(row)), np.exp(1j * angle_rad * row * np.arange(-(-count // row)))
    return np.multiply.outer(coarse, fine).ravel()[:count]


def steady_lines(time_s: np.ndarray, value_m: np.ndarray, keep: np.ndarray) -> list[SpectralLine]:
    """Find the steady lines of one sensor outside the peaks of its motion, strongest first.

    Args:
        time_s: shape (n,), s, ascending.
        value_m: shape (n,), m.
        keep: shape (n,), false for invalid samples, which are interpolated.
    """
    grid = _uniform(time_s, value_m, keep)
    if grid is None:
        return []
    start, step, value = grid
    rest = float(np.median(value[3 * len(value) // 4 :]))
    largest = float(np.max(np.abs(value - rest)))
    first = int(np.flatnonzero(np.abs(value - rest) >= 0.9 * largest)[-1])
    tail = value[first:] if len(value) - first >= max(_MIN_SAMPLES, len(value) // 4) else value
    span = Span(start + (len(value) - len(tail)) * step, step, tail - rest)
    head = _quiet_head(value - np.median(value[: max(len(value) // 50, 1)]), largest)
    found: list[SpectralLine] = []
    for at, noise in _peaks(span):
        line = _steady(span, at, noise, largest)
        if line is None:
            continue
        if head * step >= _MIN_HEAD_S and _absent(value[:head], start, step, line):
            continue
        found.append(_true_frequency(line, time_s, value_m, keep, step))
        if len(found) == _MAX_LINES:
            break
    return found


@dataclass(frozen=True)
class Span:
    """Evenly spaced values that start at start_s."""

    start_s: float
    step_s: float
    value: np.ndarray

    @property
    def length_s(self) -> float:
        """Duration of the span, s."""
        return self.step_s * len(self.value)


def _uniform(time: Array, value: Array, keep: np.ndarray) -> tuple[float, float, Array] | None:
    """Start, step and values of a record on an even grid of at most 1 kHz; None if there are too few samples."""
    t, y = (time, value) if keep.all() else (time[keep], value[keep])
    if len(t) < _MIN_SAMPLES or t[-1] <= t[0]:
        return None
    own = (t[-1] - t[0]) / (len(t) - 1)
    regular = _largest_offset(t, own) < 0.02 * own
    step = own if regular else max(usual_interval(t), 0.2 * own)
    many = int(1 / (step * _MAX_RATE_Hz) * (1 + 1e-6))
    whole = int((t[-1] - t[0]) / step + 1e-6) + 1
    even = y if regular and whole == len(t) else cast(Array, np.interp(t[0] + step * np.arange(whole), t, y))
    if many > 1:
        count = len(even) // many
        even = even[: count * many].reshape(count, many) @ np.full(many, 1 / many)
        return float(t[0] + 0.5 * (many - 1) * step), step * many, even
    return float(t[0]), step, even


@compiled(nogil=True)
def _largest_offset(time: np.ndarray, step: float) -> float:
    """Largest deviation of the times from an even grid that starts at the first one, s."""
    largest, first = 0.0, time[0]
    for i in range(len(time)):
        largest = max(largest, abs(time[i] - (first + step * i)))
    return largest


def _spectrum(span: Span) -> tuple[np.ndarray, np.ndarray, float]:
    """Windowed power, its local level, and the spacing of the ordinates, Hz."""
    n = len(span.value)
    size = next_fast_len(n)
    spectrum = np.fft.rfft(span.value * smooth_window(n), size)
    power = spectrum.real**2 + spectrum.imag**2
    return power, local_level(power), 1 / (size * span.step_s)


def local_level(power: np.ndarray) -> np.ndarray:
    """Local level of a windowed power spectrum at each ordinate, shape (n,): the median of a group of ordinates.

    Neighbouring ordinates are correlated. Such a median falls to a fifth of the mean once in a few thousand groups, and
    noise next to it would appear as a line. The level is therefore at least the median of the medians of the
    surrounding groups. It may be larger, for example next to a mode.
    """
    count = -(-len(power) // _GROUP)
    padded = np.concatenate([power, np.full(count * _GROUP - len(power), power[-_GROUP:].mean())])
    own = np.partition(padded.reshape(count, _GROUP), _GROUP // 2, axis=1)[:, _GROUP // 2]
    about = median_filter(own, _GROUPS, mode="nearest")
    return np.repeat(np.maximum(own, about), _GROUP)[: len(power)]


def _peaks(span: Span) -> Iterable[tuple[float, float]]:
    """Frequencies of narrow peaks, Hz, strongest first, each with the noise of a complex amplitude there, m."""
    power, level, spacing = _spectrum(span)
    inner = power[1:-1]
    top = 1 + np.flatnonzero((inner > power[:-2]) & (inner >= power[2:]) & (inner > _MIN_POWER_RATIO * level[1:-1]))
    lowest = 2 * _LOBE_BINS / (span.length_s * spacing)
    top = top[top > lowest]
    weight = float(smooth_window(len(span.value)).sum())
    for k in top[np.argsort(power[top])[::-1]][:_MAX_PEAKS]:
        a, b, c = np.log(power[k - 1 : k + 2])
        shift = 0.5 * (a - c) / (a - 2 * b + c)
        yield (k + shift) * spacing, 2 * float(np.sqrt(level[k] / np.log(2) / 2)) / weight


def _amplitudes(span: Span, frequency: float, centres: Sequence[float] = _CENTRES) -> tuple[np.ndarray, np.ndarray]:
    """Middle times since the span's start, s, and complex amplitudes (phase at the span's start) in the windows."""
    size = len(span.value) // 3
    window = smooth_window(size)
    window = window * (2 / window.sum())
    wave = window * _turning(-2 * np.pi * frequency * span.step_s, size)
    middles, out = list[float](), list[complex]()
    for centre in centres:
        first = round(centre * len(span.value) - size / 2)
        part = span.value[first : first + size]
        out.append(np.sum((part - part.mean()) * wave) * np.exp(-2j * np.pi * frequency * span.step_s * first))
        middles.append((first + size / 2) * span.step_s)
    return np.array(middles), np.array(out)


def _steady(span: Span, frequency: float, noise: float, largest: float) -> SpectralLine | None:
    """Line at a peak; None if the peak decays, jumps, is too weak to classify, or may be the motion itself."""
    if _clearly_decays(span, frequency, 1.8 * noise):
        return None
    middle, amplitude = _amplitudes(span, frequency)
    phase = np.unwrap(np.angle(amplitude))
    turn, _ = np.polyfit(middle, phase, 1)
    frequency += float(turn) / (2 * np.pi)
    middle, amplitude = _amplitudes(span, frequency)
    size, own = np.abs(amplitude), 1.8 * noise  # a third of the span, wider noise bandwidth
    if size.min() < 3 * own or size.min() < _MIN_AMPLITUDE * largest:
        return None
    mean = float(size.mean())
    line, cov = np.polyfit(middle, np.log(size), 1), 1.3 * own / mean / np.sqrt(np.sum((middle - middle.mean()) ** 2))
    decay = -float(line[0])
    uneven = float(np.std(np.log(size) - np.polyval(line, middle)))
    omega, length = 2 * np.pi * frequency, span.length_s
    if uneven > _MAX_SCATTER + 3 * own / mean or -decay * length > 0.5 + 3 * cov * length:
        return None
    large = mean > _LARGE_AMPLITUDE * largest  # it may be the only motion, and may grow
    limit = MAX_LINE_DAMPING * omega
    is_steady = (abs(decay) if large else decay) + 3 * cov < limit
    if not is_steady and (cov * length > _MAX_DECAY_STD or decay > max(3 * cov, limit) or large):
        return None
    phase = np.unwrap(np.angle(amplitude))
    bent = float(np.max(np.abs(phase - np.polyval(np.polyfit(middle, phase, 1), middle))))
    order = 1 if bent < 0.02 + 3 * own / mean else max(4, round(length / 2.0))
    constant = complex(np.mean(amplitude)) if order == 1 else complex(mean * np.exp(1j * phase.mean()))
    return SpectralLine(frequency, constant, span.start_s, order=min(order, 40))


def _clearly_decays(span: Span, frequency: float, noise: float) -> bool:
    """Whether the first and the last window alone show a decay, so clear that the other windows are not needed."""
    middle, amplitude = _amplitudes(span, frequency, (_CENTRES[0], _CENTRES[-1]))
    first, last = np.abs(amplitude)
    if first < 30 * noise or first < 2 * last:
        return False
    decay = np.log(first / max(last, noise)) / (middle[1] - middle[0])
    return bool(decay > 4 * MAX_LINE_DAMPING * 2 * np.pi * frequency)


def _quiet_head(value: np.ndarray, largest: float) -> int:
    """Number of values before the first large motion."""
    moved = np.abs(value) > 0.05 * largest
    return int(np.argmax(moved)) if moved.any() else len(value)


def _absent(head: np.ndarray, start: float, step: float, line: SpectralLine) -> bool:
    """Whether a quiet head contains significantly less than half of a line, which then began with the release."""
    t = step * np.arange(len(head))
    wave = np.exp(2j * np.pi * line.frequency_Hz * (t + start - line.zero_s))
    basis = np.column_stack([np.real(wave), -np.imag(wave), np.ones_like(t), t])
    found, *_ = np.linalg.lstsq(basis, head, rcond=None)
    left = float(np.std(head - basis @ found)) * np.sqrt(2 / max(len(head) / 10, 1))
    return float(np.hypot(found[0], found[1])) + 3 * left < 0.5 * abs(line.amplitude_m)


def _true_frequency(
    line: SpectralLine, time: np.ndarray, value: np.ndarray, keep: np.ndarray, step: float
) -> SpectralLine:
    """Resolve the alias of a line found in an averaged record: the frequency with the largest amplitude in the record.

    The line is unchanged if the record was not averaged.
    """
    every = usual_interval(time)
    if step < 1.5 * every:
        return line
    rate = 1 / step
    alike = [
        line.frequency_Hz,
        *(k * rate + s * line.frequency_Hz for k in range(1, int(0.5 / every / rate) + 1) for s in (-1, 1)),
    ]
    alike = [f for f in alike if f < 0.5 / every]
    first = int(np.searchsorted(time, line.zero_s))
    stop = min(len(time), first + 60_000)
    since, part = time[first:stop] - line.zero_s, np.where(keep, value, 0.0)[first:stop]
    window = smooth_window(len(since))
    part = (part - part.mean()) * window * 2 / window.sum()
    best = [complex(np.sum(part * np.exp(-2j * np.pi * f * since))) for f in alike]
    k = int(np.argmax(np.abs(best)))
    mean = np.sinc(line.frequency_Hz * step) / np.sinc(line.frequency_Hz * every)
    if k == 0:
        return SpectralLine(line.frequency_Hz, line.amplitude_m / mean, line.zero_s, 0.0, line.order)
    return SpectralLine(alike[k], best[k], line.zero_s, 0.0, line.order)


def sentences(per_sensor: Sequence[tuple[str, Sequence[SpectralLine]]]) -> list[str]:
    """Return messages that name lines by frequency and by amplitude in each sensor; empty without lines.

    Args:
        per_sensor: (name of the sensor, its lines) for every record.
    """
    groups: list[list[tuple[str, SpectralLine]]] = []
    for sensor, lines in per_sensor:
        for line in lines:
            near = [g for g in groups if abs(g[0][1].frequency_Hz - line.frequency_Hz) < 0.06]
            if near:
                near[0].append((sensor, line))
            else:
                groups.append([(sensor, line)])
    groups.sort(key=lambda g: -max(abs(line.amplitude_m) for _, line in g))
    steady = [_named(g) for g in groups if g[0][1].decay == 0.0]
    out: list[str] = []
    if steady:
        more = f"; and {len(steady) - _MAX_LISTED} more" if len(steady) > _MAX_LISTED else ""
        out.append(f"steady lines fitted out: {'; '.join(steady[:_MAX_LISTED])}{more}")
    ringing = [_named(g) for g in groups if g[0][1].decay > 0.0]
    if ringing:
        out.append(f"something else rings as well and is fitted out: {'; '.join(ringing[:_MAX_LISTED])}")
    return out


def _named(group: Sequence[tuple[str, SpectralLine]]) -> str:
    frequency = group[int(np.argmax([abs(line.amplitude_m) for _, line in group]))][1].frequency_Hz
    largest: dict[str, float] = {}
    for sensor, line in group:
        largest[sensor] = max(largest.get(sensor, 0.0), abs(line.amplitude_m))
    seen = ", ".join(f"{1e6 * a:.3g} µm in {sensor}" for sensor, a in sorted(largest.items()))
    text = f"{frequency:.2f} Hz, {seen}"
    if group[0][1].decay > 0.0:
        return f"{text}, decays within {1 / group[0][1].decay:.2g} s"
    for mains in (50.0, 60.0):
        times = round(frequency / mains)
        if times and abs(frequency - times * mains) < 0.002 * frequency + 0.02:
            return f"{text}: mains hum?"
    return text
