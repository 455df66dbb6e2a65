"""From a sensor's samples to block averages: what is left out, the noise, sample residuals against a smooth model.

Masked samples (rail, NaN, outliers) get weight zero and are never filled in. The work that goes over every sample is
compiled, so that ten times the sampling rate costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from identification.colour import Colour
from identification.errors import NotIdentifiable
from identification.lines import Line
from identification.samples import Averages, clipped, white_noise, white_noises

_NOISE_CHUNKS, _NOISE_SAMPLES = 32, 40_000  # noise is known to 1 % from so many
_LEVEL_SAMPLES, _TOP_SHARES, _LEAST_VISITS = 20_000, (0.02, 0.005, 0.001), 3
_LEAST_SAMPLES = 40
_STUCK_REPEATS, _STUCK_CHANCE = 4, 1e-2
_STAYS = 3  # times as long as any visit to a rail
_HELD, _AFTER = 50, 4  # samples that a hold repeats at least, and that it takes to a small displacement
_SMALL_STEP, _FROM_REST = 0.02, 0.36  # of the range; between a quarter of the way and half of it
_SAME_WIDTH = 0.1  # ln of two block lengths for which one colour holds
_BEYOND_BLOCKS = 0.9  # cycles a block, of which nothing is left in its mean


@dataclass(frozen=True)
class Channel:
    """One sensor's record.

    Attributes:
        time_s: shape (n,), ascending.
        value_m: shape (n,).
        keep: shape (n,), false where a sample is left out.
        noise: white noise of one sample, m.
        rail_m: lower and upper value at which the sensor saturated; ∓inf where it never did.
        lines: sinusoids that are none of the motion; value_m is without them, as far as they are known.
        colour: of the noise of block means, where it is not white.
    """

    time_s: np.ndarray
    value_m: np.ndarray
    keep: np.ndarray
    noise: float
    rail_m: tuple[float, float]
    lines: tuple[Line, ...] = ()
    colour: Colour | None = None

    def averages(self, width_s: float, begin_s: float = -np.inf, end_s: float = np.inf) -> Averages:
        """Block means of the kept samples in a span of time.

        Raises:
            NotIdentifiable: no sample is left.
        """
        first, last = np.searchsorted(self.time_s, (begin_s, end_s))
        if not self.keep[first:last].any():
            raise NotIdentifiable(f"no valid sample between {begin_s:.4g} and {end_s:.4g} s; is the sensor connected?")
        mean, spread, value, count = _average(
            self.time_s[first:last], self.value_m[first:last], self.keep[first:last], width_s
        )
        colour = self.colour_for(width_s)
        return Averages(mean, spread, value, count, colour.noise if colour else self.noise)

    def colour_for(self, width_s: float) -> Colour | None:
        """The noise's colour, if it was found for about such blocks."""
        own = self.colour
        return own if own is not None and abs(np.log(own.width_s / width_s)) < _SAME_WIDTH else None

    def line_columns(self, width_s: float, begin_s: float, end_s: float) -> np.ndarray:
        """Block means of what each line may still contribute in a span, shape (blocks, columns).

        Its complex amplitude is a polynomial of time: the line that was taken off the samples was not quite it, and
        what the modes can be known to beside it is then honest.
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
            shapes = np.polynomial.legendre.legvander(2 * (middles - middles[0]) / span - 1, line.order)
            columns += [shapes * np.real(wave)[:, None], shapes * np.imag(wave)[:, None]]
        return np.hstack(columns) if columns else np.empty((0, 0))

    @staticmethod
    def in_blocks(line: Line, width_s: float) -> bool:
        """Whether block means still show a line."""
        return line.frequency_Hz * width_s < _BEYOND_BLOCKS

    def without(self, lines: Sequence[Line]) -> Channel:
        """The samples less some lines, which a fit then has beside its modes."""
        value = self.value_m.copy()
        for line in lines:
            value -= line.at(self.time_s)
        return replace(self, value_m=value, lines=(*self.lines, *lines))

    def with_noise(self, noise: float) -> Channel:
        """The same samples, their noise better known."""
        return replace(self, noise=noise)


def read_channel(time_s: np.ndarray, value_m: np.ndarray, sensor: str) -> tuple[Channel, list[str]]:
    """A channel with rail and invalid samples masked, and remarks on what was left out.

    Args:
        sensor: its name, for the messages.
    Raises:
        NotIdentifiable: lengths differ, time does not ascend, or hardly any sample is valid.
    """
    time, value = np.ascontiguousarray(time_s, float), np.array(value_m, float)
    if time.shape != value.shape or time.ndim != 1:
        raise NotIdentifiable(
            f"expected times and displacements of one length, got shapes {time.shape} and {value.shape}"
        )
    timed = np.isfinite(time)
    if not timed.all():
        time, value = time[timed], value[timed]
    backwards = time[1:] < time[:-1]
    if backwards.any():
        at = int(np.argmax(backwards))
        raise NotIdentifiable(f"time runs backwards after sample {at} ({time[at]:.6g} s); sort the recording by time")
    railed, stuck = clipped(value), stuck_samples(value)
    if stuck.any():  # a motion that decays fast is at the rail once only
        railed |= stuck & ((value == np.nanmax(value)) | (value == np.nanmin(value)))
    finite = np.isfinite(value)
    noise = sample_noise(value if finite.all() else value[finite]) if finite.sum() >= _LEAST_SAMPLES else 0.0
    if not railed.any():
        railed = noisy_rail(value, noise)
    keep = finite & ~railed & ~stuck
    if np.count_nonzero(keep) < _LEAST_SAMPLES:
        raise NotIdentifiable(
            f"sensor {sensor}: {_state(value)}only {np.count_nonzero(keep)} of {len(value)} samples are valid; "
            f"at least {_LEAST_SAMPLES} are needed. Check its cable and its range, or give the other sensor alone"
        )
    remarks = []
    if np.any(stuck & ~railed):
        remarks.append(f"{np.count_nonzero(stuck & ~railed)} samples that repeat one value left out")
    rail = (-np.inf, np.inf)
    if railed.any():
        remarks.append(f"{np.count_nonzero(railed)} samples at the sensor's rail left out")
        middle = float(np.median(_spread_subset(value[keep])))
        low, high = value[railed & (value < middle)], value[railed & (value > middle)]
        rail = (float(np.median(low)) if len(low) else -np.inf, float(np.median(high)) if len(high) else np.inf)
    if not keep.all():
        noise = sample_noise(value[keep])
    value[~finite] = 0.0  # never read; keeps the compiled loops free of NaN
    return Channel(time, value, keep, noise, rail), remarks


def _state(value: np.ndarray) -> str:
    """What a dead sensor reads, "" when it is not dead."""
    good = value[np.isfinite(value)]
    if len(value) and not len(good):
        return "every reading is NaN, "
    if len(good) and np.all(good == good[0]):
        return f"the reading is constant at {good[0]:.6g} m, "
    return ""


def stuck_samples(value: np.ndarray) -> np.ndarray:
    """Where a sensor repeats one value more often than chance allows: dropouts to zero, to a rail, to the last value.

    Coarse steps repeat values too; how often, the pairs outside long runs tell.

    Returns:
        shape (n,), true for samples to leave out.
    """
    mask = np.zeros(len(value), bool)
    same = np.r_[False, value[1:] == value[:-1], False]
    edges = np.flatnonzero(same[1:] != same[:-1])
    first, length = edges[::2], edges[1::2] - edges[::2]
    long = length >= _STUCK_REPEATS
    if not long.any():
        return mask
    usual = (np.count_nonzero(same) - int(length[long].sum())) / max(len(value) - int(length[long].sum()), 1)
    if len(value) * usual**_STUCK_REPEATS > _STUCK_CHANCE:
        return mask
    for a, n in zip(first[long], length[long], strict=True):
        mask[a : a + n + 1] = not _held_still(value, int(a), int(n))
    return mask


def _held_still(value: np.ndarray, first: int, length: int) -> bool:
    """Whether equal samples, `length` more after the first, are a column at rest that is then let go.

    It goes off from rest: half the time to a small displacement takes it a quarter of the way. From a rail, where the
    motion comes back with a speed, it is half the way, and after a dropout the reading jumps.
    """
    last = first + length
    if length < _HELD or length > 0.8 * len(value):
        return False
    gone = np.abs(value[last + 1 :] - value[last]) >= _SMALL_STEP * float(np.nanmax(value) - np.nanmin(value))
    if not gone.any():
        return True  # rest, until the record's end
    there = int(np.argmax(gone)) + 1
    whole, half = abs(value[last + there] - value[last]), abs(value[last + there // 2] - value[last])
    return there >= _AFTER and bool(half < _FROM_REST * whole)


def noisy_rail(value: np.ndarray, sigma: float) -> np.ndarray:
    """Where a sensor whose noise comes after its limiter sat at the limit: a level at which values pile up.

    Within ±4σ of the level must lie three times as many samples as in the 36σ below, where any oscillation has more;
    hardly any may lie above, and the level must have been reached at least three times. The level is the median of the
    top (bottom) 2 %, or of fewer where the motion left the rail early. An evenly spread subset is enough to count.

    Args:
        value: shape (n,), m; NaN where there is none.
        sigma: white noise of one sample, m.
    Returns:
        shape (n,), true for samples to leave out.
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
        if held is not None:  # a column held still, not a rail, unless values pile up without it as well
            others = np.sort(sign * _spread_subset(np.delete(good, np.arange(*held))))
            level = _pile(others, sigma)
            if level is None:
                continue
            near = np.flatnonzero(np.abs(sign * good - level) < 4 * sigma)
        if np.count_nonzero(np.diff(near) > 20) >= _LEAST_VISITS - 1:
            mask |= sign * value > level - 4.5 * sigma
            if held is not None:
                mask[np.flatnonzero(finite)[slice(*held)]] = False
    return mask


def _longest_stay(near: np.ndarray) -> tuple[int, int] | None:
    """The stay near a level, from index to index, that is several times as long as all others; None where none is."""
    if len(near) < _HELD:
        return None
    edges = np.flatnonzero(np.diff(near) > 20)
    first, last = near[np.r_[0, edges + 1]], near[np.r_[edges, len(near) - 1]] + 1
    lengths = last - first
    k = int(np.argmax(lengths))
    others = np.delete(lengths, k)
    if lengths[k] < _HELD or (len(others) and lengths[k] < _STAYS * int(others.max())):
        return None
    return int(first[k]), int(last[k])


def _pile(ordered: np.ndarray, sigma: float) -> float | None:
    """The level near the top of ascending values at which they pile up; None where they do not."""
    middle = float(ordered[len(ordered) // 2])
    for share in _TOP_SHARES:
        level = float(np.median(ordered[-max(int(share * len(ordered)), 1) :]))
        if level - middle < 40 * sigma:
            continue  # that is where the noise itself has its top
        edges = np.array((-40.0, -4.0, 4.0, 5.0)) * sigma + level
        far, low, high, over = np.searchsorted(ordered, edges)
        if high - low > 3 * max(low - far, 1) and len(ordered) - over < 1e-3 * len(ordered):
            return level
    return None


def _spread_subset(value: np.ndarray) -> np.ndarray:
    """Evenly spread samples, enough for a median or a 99th percentile."""
    return value[:: max(1, len(value) // _LEVEL_SAMPLES)]


def sample_noise(value: np.ndarray) -> float:
    """White noise of one sample, from chunks that together are enough; shape (n,) in time order, NaN-free."""
    if len(value) <= _NOISE_SAMPLES:
        return max(white_noise(value), 1e-12 * float(np.ptp(value)) + 1e-300)
    size = _NOISE_SAMPLES // _NOISE_CHUNKS
    starts = np.linspace(0, len(value) - size, _NOISE_CHUNKS).astype(int)
    chunks = white_noises(value[starts[:, None] + np.arange(size)])
    return max(float(np.median(chunks)), 1e-12 * float(np.ptp(value)) + 1e-300)


@njit(cache=True, nogil=True, error_model="numpy")
def _average(
    time: np.ndarray, value: np.ndarray, keep: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean time, its variance, mean value and count per block of `width` from the first kept sample on."""
    n = len(time)
    mean, spread, level = np.empty(n), np.empty(n), np.empty(n)
    count = np.empty(n, np.int64)
    blocks, label, base, m = -1, -1, 0.0, 0
    sum_t = sum_tt = sum_v = 0.0
    zero, surely = np.nan, -np.inf  # until when a sample surely belongs to this block
    for i in range(n):
        if not keep[i]:
            continue
        if time[i] >= surely or m == 0:
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
                surely = zero + (own + 1 - 1e-5) * width
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


@njit(cache=True, nogil=True, error_model="numpy")
def taylor_at_samples(time: np.ndarray, centre: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """A smooth function at every sample from its value and derivatives at block centres.

    Args:
        time: shape (n,), ascending.
        centre: shape (m,), ascending.
        derivatives: of order 0 to 4 at the centres, shape (5, m).
    Returns:
        shape (n,); with blocks of a twentieth of a cycle exact to 1e-6 of the amplitude.
    """
    out = np.empty(len(time))
    j, last, until = -1, len(centre) - 1, -np.inf
    for i in range(len(time)):
        while time[i] >= until:  # the next centre is nearer
            j += 1
            until = 0.5 * (centre[j] + centre[j + 1]) if j < last else np.inf
        out[i] = _taylor(time[i] - centre[j], derivatives, j)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def farthest_from_taylor(
    time: np.ndarray, value: np.ndarray, kept: np.ndarray, centre: np.ndarray, derivatives: np.ndarray
) -> tuple[float, float, float]:
    """Of kept samples the largest distance from `taylor_at_samples`, and that function's lowest and highest value."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def _taylor(u: float, d: np.ndarray, j: int) -> float:
    return d[0, j] + u * (d[1, j] + u * (0.5 * d[2, j] + u * (d[3, j] / 6 + u * d[4, j] / 24)))


@njit(cache=True, nogil=True, error_model="numpy")
def _average_wave(
    time: np.ndarray, keep: np.ndarray, width: float, growth: float, omega: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean time and mean of e^{(growth + i omega)(t − first t)} in each of the blocks that `_average` makes."""
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
