"""Samples that noise does not explain: spikes before a fit, outliers against a fit, samples close to the rail.

Outliers are masked by hard trimming, which is repeated until nothing changes. It is redescending like Tukey's biweight,
but the plain least-squares covariance is valid for the remaining samples. The threshold follows the *local* scatter, so
that a misfit at large amplitudes is not masked as outliers. The noise is the smaller of the residuals' rms and that of
third differences, which contain the signal if the times are uneven. The limit for masking and for the warning depends
on the number of samples: the largest deviation of 100 000 good samples exceeds 4.5 standard deviations in every second
record.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, ndtr, ndtri

from dynamics.compiled_code import compiled
from identification.ring_down.backbone import course
from identification.ring_down.decay import FittedDecay, once_per_fit
from identification.ring_down.exact_motion import exact_motion
from identification.ring_down.model import DELAYS
from identification.ring_down.modes import rate
from identification.ring_down.record import SensorRecord, farthest_from_taylor, sample_noise, taylor_at_samples
from identification.typed_scipy import median_filter

_THRESHOLD = 4.5  # standard deviations; 7 of a million good samples exceed it
_MIN_SUSPECT_STD = 5.5  # standard deviations; exceeded by one good sample in 26 million
_FALSE_ALARM_RATE = 3e-4  # probability per fit that noise alone counts as outliers
_NORMAL = 1.4826  # standard deviation over median absolute deviation
_SCATTER_SAMPLES = 20_000  # determine a scatter to 1 %
_STRETCH_SAMPLES = 1000  # determine a scatter to 4 %
_CENTRES_PER_CYCLE = 20
_MAX_POWER = 200.0


def without_spikes(channel: SensorRecord) -> tuple[SensorRecord, int]:
    """Mask samples that jump from their neighbours. Return the channel and the number of masked samples.

    A running median over seven samples follows the motion, but not bursts of fewer than four samples.
    """
    value = channel.value_m if channel.keep.all() else channel.value_m[channel.keep]
    step = max(1, len(value) // _SCATTER_SAMPLES)
    usual = _usual(value[1:-1:step] - 0.5 * (value[:-2:step] + value[2::step]))
    if _largest_bend(value) < 12 * usual or usual == 0.0:
        return channel, 0
    off = np.abs(value - median_filter(value, 7))
    spike = off > 10 * max(_usual(off[::step]), usual)
    count = int(np.count_nonzero(spike))
    if count == 0 or count > 0.3 * len(value):
        return channel, 0
    keep = channel.keep.copy()
    keep[np.flatnonzero(keep)[spike]] = False
    return replace(channel, keep=keep), count


def _usual(off: np.ndarray) -> float:
    """Robust scatter about zero."""
    return _NORMAL * float(np.median(np.abs(off))) if len(off) else 0.0


@compiled(nogil=True)
def _largest_bend(value: np.ndarray) -> float:
    """Largest distance of a sample from the mean of its neighbours."""
    largest = 0.0
    for i in range(1, len(value) - 1):
        largest = max(largest, abs(value[i] - 0.5 * (value[i - 1] + value[i + 1])))
    return largest


def sample_residuals(
    fitted: FittedDecay, record: int, axis: int, channel: SensorRecord, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Residual and model of the samples `first` to `last` of a channel, m, shape (last − first,) each."""
    model = fitted_signal(fitted, record, axis, channel.time_s[first:last])
    return channel.value_m[first:last] - model, model


def fitted_signal(fitted: FittedDecay, record: int, axis: int, time_s: np.ndarray) -> np.ndarray:
    """Fitted signal of a sensor at ascending times, shape (n,), m. The decay is continued before its start."""
    return taylor_at_samples(time_s, *_pieces(fitted, record, axis, time_s))


def _pieces(fitted: FittedDecay, record: int, axis: int, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres over a time range, shape (m,), s, and derivatives 0 to 4 of the fitted signal there, shape (5, m)."""
    model, own = fitted.model, fitted.model.records[record]
    step = 2 * np.pi / float(np.max(fitted.omegas)) / _CENTRES_PER_CYCLE
    centre = np.arange(time_s[0] + step / 2, time_s[-1] + step, step)
    t, derivatives = centre - own.zero_s, np.zeros((5, len(centre)))
    delay = fitted.theta[DELAYS + record] if model.delays and axis else 0.0
    for mode, (omega, zeta) in enumerate(zip(fitted.omegas, fitted.zetas, strict=True)):
        if model.backbone is not None:
            derivatives += _bent_pieces(fitted, record, axis, mode, t - delay)
            continue
        lam = rate(float(omega), float(zeta))
        power = lam * (t - delay)
        power.real = np.minimum(power.real, _MAX_POWER)  # a strongly damped mode overflows before the release
        wave = fitted.amplitude(record, axis, mode) * np.exp(power)
        for k in range(5):
            derivatives[k] += wave.real
            wave = wave * lam
    order, own_t = model.drift, own.times[axis]
    coefficients = fitted.solution.coefficients[record][-len(own.channels) * (order + 1) :]
    drift = np.polynomial.Legendre(
        coefficients[axis * (order + 1) : (axis + 1) * (order + 1)], domain=[own_t[0], own_t[-1]]
    )
    derivatives[0] += drift(t)
    derivatives[1] += drift.deriv()(t)
    return centre, derivatives


def _bent_pieces(fitted: FittedDecay, record: int, axis: int, mode: int, t: np.ndarray) -> np.ndarray:
    """Derivatives for a mode whose rates depend on amplitude: averaged motion before its zero, exact motion after."""
    backbone, own = fitted.model.backbone, fitted.amplitude(record, axis, mode)
    assert backbone is not None
    rates, level = fitted.model.mode_rates(fitted.theta, mode), backbone.amplitudes_m[record][mode]
    path = course(rates, level, t)
    power = np.minimum(path.power.real, _MAX_POWER) + 1j * path.power.imag
    wave = own * np.exp(power)
    out = np.array([(wave * path.rate**k).real for k in range(5)])
    after = t >= 0
    if after.any() and abs(own) > 1e-6 * level:
        # the signal of a sensor is the motion of the mode times a factor, which may be negative
        out[:3, after] = exact_motion(rates, own, level / abs(own), t[after])
    return out


def farthest_by_chance(samples: int) -> float:
    """Limit in standard deviations that the farthest of so many good samples exceeds with _FALSE_ALARM_RATE."""
    return max(_MIN_SUSPECT_STD, float(-ndtri(0.5 * _FALSE_ALARM_RATE / max(samples, 1))))


def explained_by_noise(masked: int, samples: int, farthest: float) -> bool:
    """Whether noise alone may explain the masked samples: neither their distance nor their number is significant.

    Args:
        masked: number of samples beyond the trimming threshold.
        samples: number of examined samples.
        farthest: largest distance in standard deviations.
    """
    usual = 2 * samples * float(ndtr(-_THRESHOLD))
    few = farthest < farthest_by_chance(samples)
    return masked == 0 or (few and float(gammainc(masked, usual)) > _FALSE_ALARM_RATE)


def trimmed(
    fitted: FittedDecay, valid: tuple[tuple[np.ndarray, ...], ...]
) -> tuple[list[tuple[SensorRecord, ...]], int, bool]:
    """Mask the outliers of a fit again and re-estimate the noise.

    Args:
        fitted: solved fit.
        valid: usable samples of each record and channel, independent of earlier masks.
    Returns:
        Channels, number of masked outliers (0 if noise may explain all of them), and whether a mask changed.
    """
    out, count, changed, samples, farthest = list[tuple[SensorRecord, ...]](), 0, False, 0, 0.0
    for r, channels in enumerate(fitted.decay.records):
        own: list[SensorRecord] = []
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (fitted.decay.begins[r], fitted.decay.ends[r]))
            residual, model = sample_residuals(fitted, r, axis, channel, first, last)
            usable = valid[r][axis][first:last] & _inside_rail(model, channel)
            cycle = 2 * np.pi / float(np.min(fitted.omegas))
            good, squares, off = _inlying(residual, usable, channel.time_s[first:last], 3 * cycle)
            keep = channel.keep.copy()
            changed |= not np.array_equal(keep[first:last], good)
            keep[first:last] = good
            used = int(np.count_nonzero(good))
            looked_at = int(np.count_nonzero(usable))
            count, samples, farthest = count + looked_at - used, samples + looked_at, max(farthest, off)
            noise = channel.noise
            if used >= 40:
                # differences do not depend on the model: a misfit does not count as noise
                noise = min(float(np.sqrt(squares / used)), sample_noise(channel.value_m[first:last][good]))
            own.append(replace(channel, keep=keep, noise=noise))
        out.append(tuple(own))
    return out, 0 if explained_by_noise(count, samples, farthest) else count, changed


@once_per_fit
def suspicious(fitted: FittedDecay) -> bool:
    """Whether a kept sample is farther from the model than noise permits, or the model reaches the rail."""
    suspect = farthest_by_chance(sum(c.keep.sum() for channels in fitted.decay.records for c in channels))
    for r, channels in enumerate(fitted.decay.records):
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (fitted.decay.begins[r], fitted.decay.ends[r]))
            time, value, kept = (part[first:last] for part in (channel.time_s, channel.value_m, channel.keep))
            pieces = _pieces(fitted, r, axis, time)
            largest, lowest, highest = farthest_from_taylor(time, value, kept, *pieces)
            low, high = _clear_of_rail(channel)
            if not (low < lowest and highest < high):
                return True
            some = slice(None, None, _every(time))
            residual = value[some] - taylor_at_samples(time[some], *pieces)
            if _scatter_below(residual, kept[some], largest / suspect):
                return True
    return False


def _inside_rail(model: np.ndarray, channel: SensorRecord) -> np.ndarray:
    """Samples at which the *model* does not reach the rail.

    A selection by the data would keep the samples whose noise points inward.
    """
    low, high = _clear_of_rail(channel)
    return (model > low) & (model < high)


def _clear_of_rail(channel: SensorRecord) -> tuple[float, float]:
    """Range of values at which noise does not reach the rail, m."""
    margin = _THRESHOLD * channel.noise
    return channel.rail_m[0] + margin, channel.rail_m[1] - margin


def _scatter_below(residual: np.ndarray, kept: np.ndarray, limit: float) -> bool:
    """Whether `_scale` is below a limit. A count is sufficient unless the limit is next to the median."""
    below, count = int(np.count_nonzero(kept & (np.abs(residual) < limit / _NORMAL))), int(np.count_nonzero(kept))
    return 2 * below > count if abs(2 * below - count) > 1 else _scale(residual, kept) < limit


def _every(samples: np.ndarray) -> int:
    return max(1, len(samples) // 40_000)


def _scale(residual: np.ndarray, kept: np.ndarray) -> float:
    step = _every(residual)
    values = np.abs(residual[::step][kept[::step]])
    return max(_NORMAL * float(np.median(values)), 1e-300) if len(values) else np.inf


def _inlying(
    residual: np.ndarray, usable: np.ndarray, time: np.ndarray, span_s: float
) -> tuple[np.ndarray, float, float]:
    """Mask of usable samples within the threshold, shape (n,), their sum of squares, and the farthest usable sample.

    The scatter is the larger of that of the record and that of a stretch of a few cycles.
    """
    scale = _scale(residual, usable)
    count = int((time[-1] - time[0]) / span_s) + 1
    edges = cast(NDArray[np.int64], np.searchsorted(time, time[0] + span_s * np.arange(1, count)))
    good, squares, farthest = np.empty(len(residual), bool), 0.0, 0.0
    ends: list[int] = [0, *edges.tolist(), len(time)]
    for a, b in pairwise(ends):
        off, within = np.abs(residual[a:b]), usable[a:b]
        step = max(1, (b - a) // _STRETCH_SAMPLES)
        values = off[::step][within[::step]]
        local = _NORMAL * float(np.median(values)) if len(values) >= 12 else 0.0
        limit = _THRESHOLD * max(scale, local)
        np.logical_and(within, off <= limit, out=good[a:b])
        kept = off[good[a:b]]
        squares += float(kept @ kept)
        if len(kept) < np.count_nonzero(within):
            farthest = max(farthest, _THRESHOLD * float(np.max(off[within])) / limit)
    return good, squares, farthest
