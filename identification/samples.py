"""Preparation of sensor samples for a fit: masks, white noise, block averages.

Block averages lose no information if a block is short against the fastest cycle. The mean of f over samples at t_i is
f(t̄) + ½ v f''(t̄), where t̄ and v are the mean and the variance of the sample times. Gaps and masked samples therefore
need no interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from identification.errors import NotIdentifiable
from rig_basics import times
from rig_basics.arrays import Array
from rig_basics.texts import number_of

_MAX_INTERVALS = 20_000  # sampling intervals of which the median is taken
_FALSE_ALARM_RATE = 5e-4  # probability that white residuals are called correlated
_MIN_DEPARTURE = 0.05  # distance from a rail, over the range, that separates two visits to it


@dataclass(frozen=True)
class Averages:
    """Block averages of one channel.

    Attributes:
        time_s: mean time of the samples in each block, s, shape (n,).
        spread_s2: variance of their times, s², shape (n,).
        value: mean value, shape (n,), in the channel's unit.
        count: number of samples in each block, shape (n,).
        noise: standard deviation of the white noise of one sample, same unit.
    """

    time_s: np.ndarray
    spread_s2: np.ndarray
    value: np.ndarray
    count: np.ndarray
    noise: float

    @property
    def weight(self) -> np.ndarray:
        """Inverse of each block's standard deviation, shape (n,)."""
        return np.sqrt(self.count) / self.noise

    def between(self, start_s: float, end_s: float) -> Averages:
        """Return the blocks within a time span."""
        return self.where((self.time_s >= start_s) & (self.time_s <= end_s))

    def where(self, keep: np.ndarray) -> Averages:
        """Return the blocks for which `keep`, shape (n,), is true."""
        return Averages(self.time_s[keep], self.spread_s2[keep], self.value[keep], self.count[keep], self.noise)


def checked_times(time_s: np.ndarray, *, any_order: bool = False) -> Array:
    """Sample times as floats, after a check of what no fit can use.

    Args:
        time_s: shape (n,), s, ascending; NaN is permitted. A few repeated times are permitted.
        any_order: whether times may also run backwards, for a fit that sorts them.
    Raises:
        NotIdentifiable: the times are dates or text, run backwards, or most of them are repeated.
    """
    return times.checked_times(time_s, NotIdentifiable, any_order=any_order)


def white_noise(value: np.ndarray) -> float:
    """Standard deviation of the white part, from third differences limited by their median (robust to gaps and steps).

    A signal that is smooth over four samples does not contribute. Quantisation contributes as noise.
    """
    finite = np.isfinite(value)
    return float(white_noises(value if finite.all() else value[finite]))


def white_noises(value: np.ndarray) -> np.ndarray:
    """White noise, as in `white_noise`, of many stretches at once: values of shape (…, n) without NaN to shape (…)."""
    third = np.diff(value, 3)
    if third.shape[-1] < 20:
        raise NotIdentifiable(
            f"{number_of(value.shape[-1], 'sample is', 'samples are')} too few to estimate the noise; record longer"
        )
    robust = np.median(np.abs(third), axis=-1, keepdims=True) / 0.6745
    limit = np.where(robust > 0, 8 * robust, np.inf)  # the median of a coarsely quantised signal may be 0
    return np.sqrt(np.mean(np.clip(third, -limit, limit) ** 2, axis=-1) / 20.0)


def encoder_noise(angle: np.ndarray, step: float) -> float:
    """White noise of an encoder's samples (jitter and quantisation), from the samples during motion.

    The quantisation is white if steps are crossed quickly (half a step per sample). Samples at rest are not used: their
    scatter lies between zero and half a step and depends on where within a step the shaft stopped.

    Args:
        angle: shape (n,), in time order.
        step: quantisation step, same unit.
    Returns:
        Standard deviation, at least step/√12; 0.42 steps (a jitter of 0.3 steps) if too few samples move.
    """
    fast = np.abs(angle[20:] - angle[:-20]) > 10 * step
    third = np.diff(angle, 3)[: len(fast)][fast]
    if len(third) < 100:
        return 0.42 * step
    robust = 8 * max(step, float(np.median(np.abs(third))) / 0.6745)  # limits the effect of a push or a gap
    return max(step / np.sqrt(12), float(np.sqrt(np.mean(np.clip(third, -robust, robust) ** 2) / 20.0)))


def usual_interval(time_s: np.ndarray) -> float:
    """Median of at most 20 000 evenly spread sampling intervals, s; `time_s` is ascending, shape (n,)."""
    every = max(1, len(time_s) // _MAX_INTERVALS)
    return float(np.median(time_s[1::every] - time_s[:-1:every]))


def clipped(value: np.ndarray) -> np.ndarray:
    """Samples at a sensor's rail: at least four equal samples at the record's extreme, in at least two visits.

    Between two visits the value departs from the extreme by a twentieth of the range. A single visit does not count as
    a rail: it may be a flat peak of a coarsely quantised signal, or a column that is held before its release and whose
    reading flickers by one step.

    Returns:
        Mask of shape (n,), true for samples to leave out.
    """
    mask = np.zeros(len(value), bool)
    good = np.isfinite(value)
    if not good.any():
        return mask
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    for extreme, side in ((high, 1.0), (low, -1.0)):
        at = np.r_[False, value == extreme, False]
        edges = np.flatnonzero(at[1:] != at[:-1])
        first, last = edges[::2], edges[1::2]
        long = last - first >= 4
        if visits(value, side * (extreme - _MIN_DEPARTURE * side * (high - low)), side, first[long]) >= 2:
            mask |= value == extreme
    return mask


def visits(value: np.ndarray, level: float, side: float, at: np.ndarray) -> int:
    """Number of separate visits to an extreme. Two visits are separated by values beyond a level.

    Args:
        value: shape (n,). NaN does not separate visits.
        level: side × the value beyond which the signal has left the extreme.
        side: 1 for visits at the top, −1 at the bottom.
        at: ascending indices of samples at the extreme.
    """
    if len(at) == 0:
        return 0
    away = np.cumsum(side * value < level)
    return 1 + int(np.count_nonzero(np.diff(away[at]) > 0))


def block_averages(time_s: np.ndarray, value: np.ndarray, width_s: float, noise: float) -> Averages:
    """Average a channel over blocks of fixed duration.

    Args:
        time_s, value: shape (n,). NaN values are left out.
        width_s: duration of a block, s; at most a sixteenth of the fastest cycle.
        noise: standard deviation of the white noise of one sample, for the weights.
    Raises:
        NotIdentifiable: the record contains no valid sample.
    """
    good = np.isfinite(value) & np.isfinite(time_s)
    t, y = time_s[good], value[good]
    if len(t) == 0:
        raise NotIdentifiable("no valid sample in the record")
    label = np.floor((t - t[0]) / width_s).astype(np.int64)
    first = np.flatnonzero(np.r_[True, np.diff(label) != 0])
    count = np.diff(np.r_[first, len(t)])
    base = t[first]
    local = t - np.repeat(base, count)
    mean = np.add.reduceat(local, first) / count
    spread = np.add.reduceat((local - np.repeat(mean, count)) ** 2, first) / count
    return Averages(base + mean, spread, np.add.reduceat(y, first) / count, count, noise)


def correlation_inflation(residual: np.ndarray, window: int = 16) -> float:
    """Factor by which correlated residuals widen intervals: std of window means over its value for white residuals.

    Args:
        residual: shape (n,), in time order.
        window: samples per window.
    Returns:
        Factor, or 1 if the excess is not significant (white residuals exceed the limit in one record of 2000). The
        squared ratio of n windows is distributed as χ² of n degrees of freedom over n.
    """
    n = len(residual) // window
    if n < 8:
        return 1.0
    means: Array = np.mean(residual[: n * window].reshape(n, window), axis=1)
    ratio = float(np.mean(means**2)) * window / max(float(np.mean(residual**2)), 1e-300)
    return float(np.sqrt(ratio)) if ratio > chdtri(n, _FALSE_ALARM_RATE) / n else 1.0
