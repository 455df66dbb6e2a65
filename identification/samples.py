"""From raw sensor samples to what is fitted: masks, white noise, block averages.

Block averages lose nothing as long as a block is short against the fastest cycle: the mean of f over samples at t_i
is f(t̄) + ½ v f''(t̄) with t̄ and v the samples' mean time and variance, so gaps and masked samples need no filling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from identification.errors import NotIdentifiable

_INTERVALS = 20_000
_NOT_WHITE = 5e-4  # chance that white residuals are called correlated
_AWAY = 0.05  # of the range: how far a motion goes between two visits to a rail


@dataclass(frozen=True)
class Averages:
    """Block averages of one channel.

    Attributes:
        time_s: mean time of the samples in each block, shape (n,).
        spread_s2: variance of their times, shape (n,).
        value: mean, shape (n,), in the channel's unit.
        count: samples in each block, shape (n,).
        noise: white noise of one sample, same unit.
    """

    time_s: np.ndarray
    spread_s2: np.ndarray
    value: np.ndarray
    count: np.ndarray
    noise: float

    @property
    def weight(self) -> np.ndarray:
        """One over each block's standard deviation."""
        return np.sqrt(self.count) / self.noise

    def between(self, start_s: float, end_s: float) -> Averages:
        """The blocks inside a span of time."""
        return self.where((self.time_s >= start_s) & (self.time_s <= end_s))

    def where(self, keep: np.ndarray) -> Averages:
        """The blocks for which keep, shape (n,), is true."""
        return Averages(self.time_s[keep], self.spread_s2[keep], self.value[keep], self.count[keep], self.noise)


def white_noise(value: np.ndarray) -> float:
    """Standard deviation of the white part, from third differences and their median (gaps and steps do no harm).

    A signal that is smooth over four samples does not enter; quantisation does, as the noise that it is.
    """
    finite = np.isfinite(value)
    return float(white_noises(value if finite.all() else value[finite]))


def white_noises(value: np.ndarray) -> np.ndarray:
    """White noise as `white_noise` has it, of many stretches at once: shape (…, n), NaN-free, to (…)."""
    third = np.diff(value, 3)
    if third.shape[-1] < 20:
        raise NotIdentifiable(f"{value.shape[-1]} samples are too few to know the noise; record longer")
    robust = np.median(np.abs(third), axis=-1, keepdims=True) / 0.6745
    limit = np.where(robust > 0, 8 * robust, np.inf)  # a coarse quantiser's median may be 0
    return np.sqrt(np.mean(np.clip(third, -limit, limit) ** 2, axis=-1) / 20.0)


def encoder_noise(angle: np.ndarray, step: float) -> float:
    """White noise of an encoder's samples, jitter and quantisation, from where it moves.

    Crossing steps quickly (half a step a sample) makes quantisation white. At rest the readings show anything from no
    noise to half a step, depending on where within a step the shaft stopped: that is no measure of anything.

    Args:
        angle: shape (n,), in time order.
        step: quantisation, same unit.
    Returns:
        At least step/√12; 0.42 steps (a jitter of 0.3 steps) when too little moves.
    """
    fast = np.abs(angle[20:] - angle[:-20]) > 10 * step
    third = np.diff(angle, 3)[: len(fast)][fast]
    if len(third) < 100:
        return 0.42 * step
    robust = 8 * max(step, float(np.median(np.abs(third))) / 0.6745)  # a push or a gap is no noise
    return max(step / np.sqrt(12), float(np.sqrt(np.mean(np.clip(third, -robust, robust) ** 2) / 20.0)))


def usual_interval(time_s: np.ndarray) -> float:
    """The median of a record's sampling intervals, s, of as many as tell it, evenly spread; time_s ascending, (n,)."""
    every = max(1, len(time_s) // _INTERVALS)
    return float(np.median(time_s[1::every] - time_s[:-1:every]))


def clipped(value: np.ndarray) -> np.ndarray:
    """Where a sensor sat at its rail: runs of at least four equal samples at the record's extreme, come to repeatedly.

    Between two visits the motion goes away, by a twentieth of its range. A single visit is no rail: a flat peak of a
    coarsely quantised signal, or a column that is held still before it is let go, whose reading may flicker by a step.

    Returns:
        shape (n,), true for samples to leave out.
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
        if visits(value, side * (extreme - _AWAY * side * (high - low)), side, first[long]) >= 2:
            mask |= value == extreme
    return mask


def visits(value: np.ndarray, level: float, side: float, at: np.ndarray) -> int:
    """How many of some places, ascending, lie in visits of their own: with values beyond a level in between.

    Args:
        value: shape (n,); NaN is not beyond.
        level: side times the value below which the motion has gone away.
        side: 1 for visits at the top, −1 at the bottom.
        at: indices into value.
    """
    if len(at) == 0:
        return 0
    away = np.cumsum(side * value < level)
    return 1 + int(np.count_nonzero(np.diff(away[at]) > 0))


def block_averages(time_s: np.ndarray, value: np.ndarray, width_s: float, noise: float) -> Averages:
    """Means over fixed spans of time.

    Args:
        time_s, value: shape (n,); NaN values are left out.
        width_s: length of a block, s; at most a sixteenth of the fastest cycle.
        noise: white noise of one sample, for the weights.
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
    """How much longer intervals must be because residuals are not white: sd of window means over what white gives.

    Args:
        residual: shape (n,), in time order.
    Returns:
        1 unless the excess is beyond chance: white residuals exceed it in one record of 2000. Of n windows the ratio is
        χ² of n degrees of freedom over n, skewed to large values where they are few.
    """
    n = len(residual) // window
    if n < 8:
        return 1.0
    means = residual[: n * window].reshape(n, window).mean(axis=1)
    ratio = float(np.mean(means**2) * window / max(np.mean(residual**2), 1e-300))
    return float(np.sqrt(ratio)) if ratio > chdtri(n, _NOT_WHITE) / n else 1.0
