"""What an encoder's steps do to an estimate of a run-down.

Readings are whole steps. While a pendulum crosses many steps the rounding is noise of step/√12; near standstill it is
one constant, and least squares that take it for noise promise too much. Two remedies:

- `rounding_errors`: the curve just fitted is sent through a quantiser many times, from start angles spread over a
  step, and the estimator's linear answer to each rounding error is what it will be wrong by.
- `quantised_posterior`: the likelihood of whole steps itself, Φ((n + ½ − m)/s) − Φ((n − ½ − m)/s) with the angle m in
  steps and the jitter s unknown, explored by an ensemble of walkers (Goodman and Weare, Comm. Appl. Math. Comp. Sci. 5,
  2010, 65–80). Nothing is linearised and nothing about s → 0, where the likelihood becomes a box, is assumed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from identification.pendulums.run_down import RunDown

Array = NDArray[np.float64]

_LEAST_JITTER, _MOST_JITTER = 0.02, 1.5  # in steps
_STRETCH = 2.0


def rounding_errors(curves_rad: np.ndarray, step_rad: float, jitter_rad: float, seed: int) -> np.ndarray:
    """Errors of an encoder's readings of some curves, their start angles spread evenly over a step.

    Args:
        curves_rad: shape (draws, n).
        jitter_rad: noise before the rounding.
    Returns:
        shape (draws, n), rad.
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
    """θ = (θ0, v0, ln λ, h, ln s); angles in rad, s in steps. Flat in all of them but for bounds."""
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
        # 1e-9 of all readings may be anything: one wild one does not decide
        total += math.log(p + 1e-9)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(walkers: Array, steps: int, time: Array, count: Array, step: float, friction: bool, seed: int) -> Array:
    """Stretch moves; returns the positions after every sweep, shape (steps, walkers, 5)."""
    np.random.seed(seed)
    n, dimension = walkers.shape[0], (5 if friction else 4)
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
    """Draws of (θ0, v0, ln λ, h) given whole steps; h is 0 throughout when theta has no friction.

    Args:
        data: a quantised run-down.
        theta, covariance: where least squares ended, shapes (3 or 4,), (3 or 4, 3 or 4): the walkers start around it.
        sweeps: moves of each walker that are kept; half as many come before.
    Returns:
        shape (sweeps × walkers, 4).
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
