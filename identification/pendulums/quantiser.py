"""Effect of an encoder's quantisation on the estimate of a run-down.

Readings are integer multiples of a step. While a pendulum crosses many steps, the rounding error is noise of step/√12.
Near standstill it is constant, and least squares with the assumption of noise underestimate the uncertainty. There are
two methods:

- `rounding_errors`: the fitted curve is quantised many times, with start angles spread over a step. The linear response
  of the estimator to each rounding error is a sample of its error.
- `quantised_posterior`: the likelihood of the integer readings, Φ((n + ½ − m)/s) − Φ((n − ½ − m)/s) with the angle m in
  steps and unknown jitter s, is sampled by an ensemble of walkers (Goodman and Weare, Comm. Appl. Math. Comp. Sci. 5,
  2010, 65–80). It is not linearised, and it holds also for s → 0, where the likelihood becomes a box.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from identification.pendulums.run_down import RunDown
from rig_basics.arrays import Array

_LEAST_JITTER, _MOST_JITTER = 0.02, 1.5  # in steps
_STRETCH = 2.0


def rounding_errors(curves_rad: np.ndarray, step_rad: float, jitter_rad: float, seed: int) -> np.ndarray:
    """Return the errors of an encoder's readings of curves whose start angles are spread evenly over a step.

    Args:
        curves_rad: shape (draws, n).
        step_rad: quantisation step, rad.
        jitter_rad: standard deviation of the noise before the rounding, rad.
        seed: seed of the random numbers.
    Returns:
        Errors, rad, shape (draws, n).
    """
    rng, draws = np.random.default_rng(seed), len(curves_rad)
    shifted = curves_rad + (step_rad * (rng.permutation(draws) + 0.5) / draws)[:, None]
    read = shifted / step_rad
    if jitter_rad:
        jitter = rng.standard_normal(shifted.shape)
        jitter *= jitter_rad / step_rad
        read += jitter
    np.rint(read, out=read)
    read *= step_rad
    read -= shifted
    return read


@njit(cache=True, nogil=True, error_model="numpy")
def _log_posterior(theta: Array, time: Array, count: Array, step: float, friction: bool) -> float:
    """Return the log posterior of θ = (θ0, v0, ln λ, h, ln s), angles in rad, s in steps, with a flat bounded prior."""
    share = theta[3] if friction else 0.0
    s = math.exp(theta[4])
    if s < _LEAST_JITTER or s > _MOST_JITTER or share < -0.5 or share > 1e3 or abs(theta[2]) > 20.0:
        return -np.inf
    rate = math.exp(theta[2])
    stop = math.log1p(1.0 / share) / rate if share > 0.0 else np.inf
    scale, total = 1.0 / (s * math.sqrt(2.0)), 0.0
    for k in range(len(time)):
        t = min(time[k], stop)
        fallen = (1.0 - math.exp(-rate * t)) / rate
        off = count[k] - (theta[0] + theta[1] * ((1.0 + share) * fallen - share * t)) / step
        low, high = (abs(off) - 0.5) * scale, (abs(off) + 0.5) * scale
        p = 0.5 * (math.erfc(low) - math.erfc(high))
        # an outlier share of 1e-9 limits the influence of a single outlier
        total += math.log(p + 1e-9)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(walkers: Array, steps: int, time: Array, count: Array, step: float, friction: bool, seed: int) -> Array:
    """Make stretch moves; return the positions after every sweep, shape (steps, walkers, 5)."""
    np.random.seed(seed)
    n: int = walkers.shape[0]
    dimension = 5 if friction else 4
    kept = np.empty((steps, n, 5))
    level = np.empty(n)
    for i in range(n):
        level[i] = _log_posterior(walkers[i], time, count, step, friction)
    trial = np.empty(5)
    for sweep in range(steps):
        for i in range(n):
            half = n // 2
            other = np.random.randint(0, half) + (half if i < half else 0)
            z = ((_STRETCH - 1.0) * np.random.random() + 1.0) ** 2 / _STRETCH
            for j in range(5):
                trial[j] = walkers[other, j] + z * (walkers[i, j] - walkers[other, j])
            reached = _log_posterior(trial, time, count, step, friction)
            if math.log(np.random.random()) < (dimension - 1) * math.log(z) + reached - level[i]:
                walkers[i] = trial
                level[i] = reached
        kept[sweep] = walkers
    return kept


def quantised_posterior(
    data: RunDown, theta: np.ndarray, covariance: np.ndarray, sweeps: int, seed: int = 1, walkers: int = 32
) -> np.ndarray:
    """Return samples of (θ0, v0, ln λ, h) for integer readings; h is 0 if theta has no friction.

    Args:
        data: quantised run-down.
        theta, covariance: least-squares estimate, around which the walkers start, shapes (3 or 4,), (3 or 4, 3 or 4).
        sweeps: number of stored moves of each walker, after half as many moves that are discarded.
        seed: seed of the random numbers.
        walkers: number of walkers.
    Returns:
        Samples, shape (sweeps × walkers, 4).
    """
    rng = np.random.default_rng(seed)
    friction, size = len(theta) == 4, len(theta)
    start = np.zeros((walkers, 5))
    scale = 0.5 * np.linalg.cholesky(covariance + 1e-300 * np.eye(size))
    start[:, :size] = theta + rng.standard_normal((walkers, size)) @ scale.T
    start[:, 4] = np.log(rng.uniform(0.1, 0.5, walkers))
    count = np.round(data.angle_rad / data.step_rad)
    burn = sweeps // 2
    kept = _walk(start, burn + sweeps, data.time_s, count, data.step_rad, friction, seed)
    return kept[burn:, :, :4].reshape(-1, 4)
