"""Preparation of a sensor's record: masks, noise, block averages, and residuals of samples against a smooth model.

Masked samples (rail, NaN, outliers) have weight zero and are never interpolated. A rail is a run of equal values at an
extreme that the motion leaves and reaches again (a held column is there once), or a level at which values accumulate.
Other repeated values are a dropout if they are unlikely by chance. Loops over all samples are compiled, so
that a tenfold sampling rate costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from identification.colour import Colour
from identification.errors import NotIdentifiable
from identification.lines import SpectralLine
from identification.samples import Averages, checked_times, clipped, white_noise, white_noises
from identification.work import spend
from rig_basics.texts import number_of

_NOISE_CHUNKS, _NOISE_SAMPLES = 32, 40_000  # these samples determine the noise to 1 %
_LEVEL_SAMPLES, _TOP_SHARES, _MIN_VISITS = 20_000, (0.02, 0.005, 0.001), 3
_MIN_SAMPLES = 40
_STUCK_REPEATS, _MAX_STUCK_CHANCE = 4, 1e-2
_HOLD_RATIO = 3  # duration of a hold over that of the longest visit to a rail
_MIN_HOLD_SAMPLES, _MIN_DEPARTURE_SAMPLES = 50, 4  # equal samples of a hold; samples until a small displacement
_SMALL_STEP, _MAX_HALF_WAY = 0.02, 0.36  # of the range; displacement at half time: ¼ from rest, ½ at constant speed
_MAX_WIDTH_CHANGE = 0.1  # |ln| of the ratio of two block durations for which one colour is valid
_MAX_CYCLES_PER_BLOCK = 0.9  # a line with more cycles vanishes in block means


@dataclass(frozen=True)
class SensorRecord:
    """Record of one sensor.

    Attributes:
        time_s: shape (n,), s, ascending.
        value_m: displacement, shape (n,), m.
        keep: shape (n,), false for samples that are left out.
        noise: white noise of one sample, m.
        rail_m: lower and upper value at which the sensor saturated, m; ∓inf if it did not.
        lines: sinusoids that are not part of the motion. Their estimates are subtracted from value_m.
        colour: model of the noise of block means; None if it is white.
    """

    time_s: np.ndarray
    value_m: np.ndarray
    keep: np.ndarray
    noise: float
    rail_m: tuple[float, float]
    lines: tuple[SpectralLine, ...] = ()
    colour: Colour | None = None

    def averages(self, width_s: float, begin_s: float = -np.inf, end_s: float = np.inf) -> Averages:
        """Block means of the kept samples in a time span.

        Raises:
            NotIdentifiable: the span contains no valid sample.
        """
        first, last = np.searchsorted(self.time_s, (begin_s, end_s))
        spend(last - first)
        if not self.keep[first:last].any():
            raise NotIdentifiable(f"no valid sample between {begin_s:.4g} and {end_s:.4g} s; is the sensor connected?")
        mean, spread, value, count = _average(
            self.time_s[first:last], self.value_m[first:last], self.keep[first:last], width_s
        )
        colour = self.colour_for(width_s)
        return Averages(mean, spread, value, count, colour.noise if colour else self.noise)

    def colour_for(self, width_s: float) -> Colour | None:
        """Colour of the noise, if it was determined for blocks of about this duration."""
        own = self.colour
        return own if own is not None and abs(np.log(own.width_s / width_s)) < _MAX_WIDTH_CHANGE else None

    def line_columns(self, width_s: float, begin_s: float, end_s: float) -> np.ndarray:
        """Block means of the basis functions of each line in a span, shape (blocks, columns).

        The complex amplitude of a line is a polynomial of time. The columns correct the estimate that was subtracted
        from the samples, and the uncertainty of the modes then includes that of the lines.
        """
        first, last = np.searchsorted(self.time_s, (begin_s, end_s))
        time, keep = self.time_s[first:last], self.keep[first:last]
        columns: list[np.ndarray] = []
        middles = np.empty(0)
        for line in self.lines:
            if not self.in_blocks(line, width_s):
                continue
            middles, wave = _average_wave(time, keep, width_s, line.rate.real, line.rate.imag)
            span = max(float(middles[-1] - middles[0]), 1e-9)
            place = 2 * (middles - middles[0]) / span - 1
            shapes = cast(NDArray[np.float64], np.polynomial.legendre.legvander(place, line.order))
            columns += [shapes * np.real(wave)[:, None], shapes * np.imag(wave)[:, None]]
        return np.hstack(columns) if columns else np.empty((0, 0))

    @staticmethod
    def in_blocks(line: SpectralLine, width_s: float) -> bool:
        """Whether a line is visible in block means."""
        return line.frequency_Hz * width_s < _MAX_CYCLES_PER_BLOCK

    def without(self, lines: Sequence[SpectralLine]) -> SensorRecord:
        """Return the channel with lines subtracted. The fit then contains their columns."""
        value = self.value_m.copy()
        for line in lines:
            value -= line.at(self.time_s)
        return replace(self, value_m=value, lines=(*self.lines, *lines))

    def with_noise(self, noise: float) -> SensorRecord:
        """Return the channel with another noise, m."""
        return replace(self, noise=noise)


def read_channel(time_s: np.ndarray, value_m: np.ndarray, sensor: str) -> tuple[SensorRecord, list[str]]:
    """Read a channel and mask invalid samples and samples at the rail.

    Args:
        time_s, value_m: shape (n,), s and m.
        sensor: name of the sensor, for messages.
    Returns:
        The channel, and remarks on samples that were left out.
    Raises:
        NotIdentifiable: the lengths differ, fewer than 40 samples are valid, or times are as in checked_times.
    """
    time, value = checked_times(time_s), np.array(value_m, float)
    if time.shape != value.shape or time.ndim != 1:
        raise NotIdentifiable(
            f"expected times and displacements of one length, got shapes {time.shape} and {value.shape}"
        )
    timed = np.isfinite(time)
    if not timed.all():
        time, value = time[timed], value[timed]
    railed, stuck = clipped(value), stuck_samples(value)
    if stuck.any():  # a motion that decays fast is at the rail only once
        railed |= stuck & ((value == np.nanmax(value)) | (value == np.nanmin(value)))
    finite = np.isfinite(value)
    noise = sample_noise(value if finite.all() else value[finite]) if finite.sum() >= _MIN_SAMPLES else 0.0
    if not railed.any():
        railed = noisy_rail(value, noise)
    keep = finite & ~railed & ~stuck
    if np.count_nonzero(keep) < _MIN_SAMPLES:
        raise NotIdentifiable(
            f"sensor {sensor}: {_state(value)}only {np.count_nonzero(keep)} of "
            f"{number_of(len(value), 'sample is', 'samples are')} valid; "
            f"at least {_MIN_SAMPLES} are needed. Check its cable and its range, or give the other sensor alone"
        )
    remarks: list[str] = []
    if np.any(stuck & ~railed):
        remarks.append(f"{number_of(np.count_nonzero(stuck & ~railed), 'sample')} of one repeated value left out")
    rail = (-np.inf, np.inf)
    if railed.any():
        remarks.append(f"{number_of(np.count_nonzero(railed), 'sample')} at the sensor's rail left out")
        middle = float(np.median(_spread_subset(value[keep])))
        low, high = value[railed & (value < middle)], value[railed & (value > middle)]
        rail = (float(np.median(low)) if len(low) else -np.inf, float(np.median(high)) if len(high) else np.inf)
    if not keep.all():
        noise = sample_noise(value[keep])
    value[~finite] = 0.0  # not used; keeps the compiled loops free of NaN
    return SensorRecord(time, value, keep, noise, rail), remarks


def _state(value: np.ndarray) -> str:
    """Description of a dead sensor's reading; "" if the sensor is not dead."""
    good = value[np.isfinite(value)]
    if len(value) and not len(good):
        return "every reading is NaN, "
    if len(good) and np.all(good == good[0]):
        return f"the reading is constant at {good[0]:.6g} m, "
    return ""


def stuck_samples(value: np.ndarray) -> np.ndarray:
    """Samples at which a sensor repeats one value more often than by chance (dropout to zero, rail or last value).

    Coarsely quantised signals repeat values too. The pairs of equal samples outside long runs give their frequency.

    Returns:
        Mask of shape (n,), true for samples to leave out.
    """
    mask = np.zeros(len(value), bool)
    same = np.r_[False, value[1:] == value[:-1], False]
    edges = np.flatnonzero(same[1:] != same[:-1])
    first, length = edges[::2], edges[1::2] - edges[::2]
    long = length >= _STUCK_REPEATS
    if not long.any():
        return mask
    usual = (np.count_nonzero(same) - int(length[long].sum())) / max(len(value) - int(length[long].sum()), 1)
    if len(value) * usual**_STUCK_REPEATS > _MAX_STUCK_CHANCE:
        return mask
    for a, n in zip(first[long], length[long], strict=True):
        mask[a : a + n + 1] = not _held_still(value, int(a), int(n))
    return mask


def _held_still(value: np.ndarray, first: int, length: int) -> bool:
    """Whether equal samples, `length` more after the first, are a column at rest before its release.

    A column starts from rest: at half the time to a small displacement it has covered a quarter of the distance. Motion
    that returns from a rail has a speed and has covered half of it. After a dropout the reading jumps.
    """
    last = first + length
    if length < _MIN_HOLD_SAMPLES or length > 0.8 * len(value):
        return False
    gone = np.abs(value[last + 1 :] - value[last]) >= _SMALL_STEP * float(np.nanmax(value) - np.nanmin(value))
    if not gone.any():
        return True  # rest until the end of the record
    there = int(np.argmax(gone)) + 1
    whole, half = abs(value[last + there] - value[last]), abs(value[last + there // 2] - value[last])
    return there >= _MIN_DEPARTURE_SAMPLES and bool(half < _MAX_HALF_WAY * whole)


def noisy_rail(value: np.ndarray, sigma: float) -> np.ndarray:
    """Samples at the limit of a sensor with noise after its limiter: a level at which values accumulate.

    The interval ±4σ about the level must contain three times as many samples as the 36σ below, where every oscillation
    has more. At most 0.1 % may lie above, and the level must be reached at least three times. The level is the median
    of the top (bottom) 2 %, or of fewer if the motion left the rail early. An evenly spread subset is counted.

    Args:
        value: shape (n,), m; NaN for missing samples.
        sigma: white noise of one sample, m.
    Returns:
        Mask of shape (n,), true for samples to leave out.
    """
    mask = np.zeros(len(value), bool)
    finite = np.isfinite(value)
    good = value if finite.all() else value[finite]
    if len(good) < 1000:
        return mask
    ordered = np.sort(_spread_subset(good))
    for sign, upward in ((1.0, ordered), (-1.0, -ordered[::-1])):
        level = _pile(upward, sigma)
        if level is None:
            continue
        near = np.flatnonzero(np.abs(sign * good - level) < 4 * sigma)
        held = _longest_stay(near)
        if held is not None:  # a hold and not a rail, unless values accumulate without it as well
            others = np.sort(sign * _spread_subset(np.delete(good, np.arange(*held))))
            level = _pile(others, sigma)
            if level is None:
                continue
            near = np.flatnonzero(np.abs(sign * good - level) < 4 * sigma)
        if np.count_nonzero(np.diff(near) > 20) >= _MIN_VISITS - 1:
            mask |= sign * value > level - 4.5 * sigma
            if held is not None:
                mask[np.flatnonzero(finite)[slice(*held)]] = False
    return mask


def _longest_stay(near: np.ndarray) -> tuple[int, int] | None:
    """First and end index of the stay near a level that is several times as long as all others; None without one."""
    if len(near) < _MIN_HOLD_SAMPLES:
        return None
    edges = np.flatnonzero(np.diff(near) > 20)
    first, last = near[np.r_[0, edges + 1]], near[np.r_[edges, len(near) - 1]] + 1
    lengths = last - first
    k = int(np.argmax(lengths))
    others = np.delete(lengths, k)
    if lengths[k] < _MIN_HOLD_SAMPLES or (len(others) and lengths[k] < _HOLD_RATIO * int(others.max())):
        return None
    return int(first[k]), int(last[k])


def _pile(ordered: np.ndarray, sigma: float) -> float | None:
    """Level near the top of ascending values at which they accumulate, or None."""
    middle = float(ordered[len(ordered) // 2])
    for share in _TOP_SHARES:
        level = float(np.median(ordered[-max(int(share * len(ordered)), 1) :]))
        if level - middle < 40 * sigma:
            continue  # the noise itself reaches this level
        edges = np.array((-40.0, -4.0, 4.0, 5.0)) * sigma + level
        far, low, high, over = np.searchsorted(ordered, edges)
        if high - low > 3 * max(low - far, 1) and len(ordered) - over < 1e-3 * len(ordered):
            return level
    return None


def _spread_subset(value: np.ndarray) -> np.ndarray:
    """Return evenly spread samples, sufficient for a median or a 99th percentile."""
    return value[:: max(1, len(value) // _LEVEL_SAMPLES)]


def sample_noise(value: np.ndarray) -> float:
    """White noise of one sample, from a limited number of chunks; values of shape (n,) in time order, without NaN."""
    if len(value) <= _NOISE_SAMPLES:
        return max(white_noise(value), 1e-12 * float(np.ptp(value)) + 1e-300)
    size = _NOISE_SAMPLES // _NOISE_CHUNKS
    starts = np.linspace(0, len(value) - size, _NOISE_CHUNKS).astype(int)
    chunks = white_noises(value[starts[:, None] + np.arange(size)])
    return max(float(np.median(chunks)), 1e-12 * float(np.ptp(value)) + 1e-300)


@compiled(nogil=True)
def _average(
    time: np.ndarray, value: np.ndarray, keep: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean time, its variance, mean value and count of each block of `width`, starting at the first kept sample."""
    n = len(time)
    mean, spread, level = np.empty(n), np.empty(n), np.empty(n)
    count = np.empty(n, np.int64)
    blocks, label, base, m = -1, -1, 0.0, 0
    sum_t = sum_tt = sum_v = 0.0
    zero, inside_until = np.nan, -np.inf  # samples before inside_until belong to this block
    for i in range(n):
        if not keep[i]:
            continue
        if time[i] >= inside_until or m == 0:
            if np.isnan(zero):
                zero = time[i]
            # a sampling interval that divides the width must not straddle an edge by rounding
            own = int(np.floor((time[i] - zero) / width + 1e-6))
            if own != label:
                if m > 0:
                    mean[blocks], level[blocks], count[blocks] = base + sum_t / m, sum_v / m, m
                    spread[blocks] = max(sum_tt / m - (sum_t / m) ** 2, 0.0)
                blocks, label, base, m = blocks + 1, own, time[i], 0
                sum_t = sum_tt = sum_v = 0.0
                inside_until = zero + (own + 1 - 1e-5) * width
        local = time[i] - base
        sum_t += local
        sum_tt += local * local
        sum_v += value[i]
        m += 1
    if m > 0:
        mean[blocks], level[blocks], count[blocks] = base + sum_t / m, sum_v / m, m
        spread[blocks] = max(sum_tt / m - (sum_t / m) ** 2, 0.0)
    used = blocks + 1
    return mean[:used].copy(), spread[:used].copy(), level[:used].copy(), count[:used].copy()


@compiled(nogil=True)
def taylor_at_samples(time: np.ndarray, centre: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Evaluate a smooth function at every sample from its derivatives at block centres.

    Args:
        time: shape (n,), ascending.
        centre: shape (m,), ascending.
        derivatives: derivatives of order 0 to 4 at the centres, shape (5, m).
    Returns:
        Values of shape (n,), exact to 1e-6 of the amplitude for blocks of a twentieth of a cycle.
    """
    out = np.empty(len(time))
    j, last, until = -1, len(centre) - 1, -np.inf
    for i in range(len(time)):
        while time[i] >= until:  # the next centre is nearer
            j += 1
            until = 0.5 * (centre[j] + centre[j + 1]) if j < last else np.inf
        out[i] = _taylor(time[i] - centre[j], derivatives, j)
    return out


@compiled(nogil=True)
def farthest_from_taylor(
    time: np.ndarray, value: np.ndarray, kept: np.ndarray, centre: np.ndarray, derivatives: np.ndarray
) -> tuple[float, float, float]:
    """Largest distance of kept samples from `taylor_at_samples`, and the minimum and maximum of that function."""
    largest, lowest, highest = 0.0, np.inf, -np.inf
    j, last, until = -1, len(centre) - 1, -np.inf
    for i in range(len(time)):
        while time[i] >= until:
            j += 1
            until = 0.5 * (centre[j] + centre[j + 1]) if j < last else np.inf
        if kept[i]:
            model = _taylor(time[i] - centre[j], derivatives, j)
            largest = max(largest, abs(value[i] - model))
            lowest, highest = min(lowest, model), max(highest, model)
    return largest, lowest, highest


@compiled(part=True)
def _taylor(u: float, d: np.ndarray, j: int) -> float:
    return d[0, j] + u * (d[1, j] + u * (0.5 * d[2, j] + u * (d[3, j] / 6 + u * d[4, j] / 24)))


@compiled(nogil=True)
def _average_wave(
    time: np.ndarray, keep: np.ndarray, width: float, growth: float, omega: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean time and mean of e^{(growth + i omega)(t − first t)} in each block of `_average`."""
    n = len(time)
    middle, mean = np.empty(n), np.empty(n, np.complex128)
    blocks, label, m = -1, -1, 0
    sum_t, total = 0.0, 0.0 + 0.0j
    zero = np.nan
    for i in range(n):
        if not keep[i]:
            continue
        if np.isnan(zero):
            zero = time[i]
        since = time[i] - zero
        own = int(np.floor(since / width + 1e-6))
        if own != label:
            if m > 0:
                middle[blocks], mean[blocks] = sum_t / m, total / m
            blocks, label, m = blocks + 1, own, 0
            sum_t, total = 0.0, 0.0 + 0.0j
        sum_t += since
        total += np.exp(growth * since) * (np.cos(omega * since) + 1j * np.sin(omega * since))
        m += 1
    if m > 0:
        middle[blocks], mean[blocks] = sum_t / m, total / m
    return middle[: blocks + 1].copy(), mean[: blocks + 1].copy()
