"""Samples that no noise explains: spikes before a fit, outliers against a fit, samples too near to the rail.

Outliers are masked by hard trimming, repeated until nothing changes: redescending like Tukey's biweight, but with the
plain least-squares covariance valid for what is left. The threshold follows the *local* scatter, so a model that does
not fit at large amplitudes cannot hide its misfit as outliers.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from identification.ring_down.decay import Fitted
from identification.ring_down.model import DELAYS
from identification.ring_down.modes import rate
from identification.ring_down.record import Channel, sample_noise, taylor_at_samples

_THRESHOLD = 4.5  # standard deviations; 7 of a million good samples are lost
_SUSPECT = 5.5  # one sample in 26 million
_NORMAL = 1.4826
_CENTRES_PER_CYCLE = 20


def without_spikes(channel: Channel) -> tuple[Channel, int]:
    """The channel with samples masked that jump from their neighbours; number masked.

    A running median of seven follows the motion and no burst shorter than four samples.
    """
    kept = np.flatnonzero(channel.keep)
    value = channel.value_m[kept]
    bend = value[1:-1] - 0.5 * (value[:-2] + value[2:])
    usual = _NORMAL * float(np.median(np.abs(bend[:: max(1, len(bend) // 20_000)])))
    if float(np.max(np.abs(bend), initial=0.0)) < 12 * usual or usual == 0.0:
        return channel, 0
    off = np.abs(value - median_filter(value, 7))
    spike = off > 10 * max(_NORMAL * float(np.median(off)), usual)
    count = int(np.count_nonzero(spike))
    if count == 0 or count > 0.3 * len(value):
        return channel, 0
    keep = channel.keep.copy()
    keep[kept[spike]] = False
    return replace(channel, keep=keep), count


def sample_residuals(
    fitted: Fitted, record: int, axis: int, channel: Channel, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Samples `first` to `last` of a channel against the model: (residual, model), m; shape (last − first,) each."""
    model = fitted_signal(fitted, record, axis, channel.time_s[first:last])
    return channel.value_m[first:last] - model, model


def fitted_signal(fitted: Fitted, record: int, axis: int, time_s: np.ndarray) -> np.ndarray:
    """The fitted signal of a sensor at any times, ascending, shape (n,); m. Before its begin the decay is continued."""
    model, own = fitted.model, fitted.model.records[record]
    step = 2 * np.pi / float(np.max(fitted.omegas)) / _CENTRES_PER_CYCLE
    centre = np.arange(time_s[0] + step / 2, time_s[-1] + step, step)
    t, derivatives = centre - own.zero_s, np.zeros((5, len(centre)))
    delay = fitted.theta[DELAYS + record] if model.delays and axis else 0.0
    for mode, (omega, zeta) in enumerate(zip(fitted.omegas, fitted.zetas, strict=True)):
        lam = rate(float(omega), float(zeta))
        wave = fitted.amplitude(record, axis, mode) * np.exp(lam * (t - delay))
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
    return taylor_at_samples(time_s, centre, derivatives)


def trimmed(fitted: Fitted, valid: tuple[tuple[np.ndarray, ...], ...]) -> tuple[list[tuple[Channel, ...]], int, bool]:
    """Channels of a fit with outliers masked anew and their noise re-estimated.

    Args:
        valid: per record and channel the samples that may be used at all, whatever was masked since.
    Returns:
        The channels, how many samples are masked as outliers, and whether any mask changed.
    """
    out, count, changed = [], 0, False
    for r, channels in enumerate(fitted.decay.records):
        own = []
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (fitted.decay.begins[r], fitted.decay.ends[r]))
            residual, model = sample_residuals(fitted, r, axis, channel, first, last)
            usable = valid[r][axis][first:last] & _inside_rail(model, channel)
            scale = _scale(residual, usable)
            cycle = 2 * np.pi / float(np.min(fitted.omegas))
            local = _local_scale(residual, usable, channel.time_s[first:last], 3 * cycle)
            good = usable & (np.abs(residual) <= _THRESHOLD * np.maximum(scale, local))
            keep = channel.keep.copy()
            changed |= bool(np.any(keep[first:last] != good))
            keep[first:last] = good
            count += int(np.count_nonzero(usable & ~good))
            noise = channel.noise
            if np.count_nonzero(good) >= 40:
                # differences know nothing of the model, so a misfit does not pass for noise
                noise = min(
                    float(np.sqrt(np.mean(residual[good] ** 2))), sample_noise(channel.value_m[first:last][good])
                )
            own.append(replace(channel, keep=keep, noise=noise))
        out.append(tuple(own))
    return out, count, changed


def suspicious(fitted: Fitted) -> bool:
    """Whether any kept sample is farther from the model than noise goes, or the rail cuts samples off."""
    for r, channels in enumerate(fitted.decay.records):
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (fitted.decay.begins[r], fitted.decay.ends[r]))
            residual, model = sample_residuals(fitted, r, axis, channel, first, last)
            kept = channel.keep[first:last]
            if np.max(np.abs(residual), where=kept, initial=0.0) > _SUSPECT * _scale(residual, kept):
                return True
            if np.any(kept & ~_inside_rail(model, channel)):
                return True
    return False


def _inside_rail(model: np.ndarray, channel: Channel) -> np.ndarray:
    """Where the *model* stays clear of the rail: choosing by the data would keep those whose noise points inward."""
    low, high = channel.rail_m
    margin = _THRESHOLD * channel.noise
    return (model > low + margin) & (model < high - margin)


def _scale(residual: np.ndarray, kept: np.ndarray) -> float:
    step = max(1, len(residual) // 40_000)
    values = np.abs(residual[::step][kept[::step]])
    return max(_NORMAL * float(np.median(values)), 1e-300) if len(values) else np.inf


def _local_scale(residual: np.ndarray, kept: np.ndarray, time: np.ndarray, span_s: float) -> np.ndarray:
    """Median scatter in stretches of a few cycles, for every sample."""
    label = np.floor((time - time[0]) / span_s).astype(int)
    edges = np.searchsorted(label, np.arange(label[-1] + 2))
    out = np.zeros(len(residual))
    for a, b in pairwise(edges):
        values = np.abs(residual[a:b][kept[a:b]])
        if len(values) >= 12:
            out[a:b] = _NORMAL * np.median(values)
    return out
