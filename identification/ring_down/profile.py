"""Profile likelihood of a turned pair: intervals for an axis angle that is too uncertain for Wald intervals.

If both directions have nearly equal rates, χ² as a function of β is a long curved valley. β is swept, and at each value
the other parameters are fitted again. At fixed β they are nearly Gaussian: a parameter q has the likelihood interval
q(β) ± sd(β) sqrt(3.84 − ΔX(β)). The union over β is its profile interval. Mean and spread of the likelihood over β
yield the covariance for a joint estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Minimum, solve_separable
from identification.ring_down.decay import FittedDecay, Priors, prior_std
from identification.ring_down.model import BETA

_CHI2_95 = 3.8415  # 95 % quantile of χ² with one degree of freedom
_MAX_BETA_RAD = np.radians(44.0)
_MAPPED = BETA + 1  # number of parameters with a profile
_MAX_ITERATIONS = 10


@dataclass(frozen=True)
class Profile:
    """Profile intervals and covariance.

    Attributes:
        low, high: ends of the intervals of (ln ω1, ζ1, ln ω2, ζ2, β), shape (5,).
        covariance: covariance of the same, shape (5, 5): covariance at fixed β plus spread of q(β) over the likelihood.
        closed: whether the interval of β ends within ±44°.
    """

    low: np.ndarray
    high: np.ndarray
    covariance: np.ndarray
    closed: bool


def profile_axis(fitted: FittedDecay, priors: Priors, stretch: float = 1.0, points: int = 15) -> Profile:
    """Sweep β over ±44° from the fitted value to both sides.

    Args:
        fitted: solved fit of a turned pair.
        priors: priors of the fit.
        stretch: factor on standard deviations for noise above white noise.
        points: number of values of β over the whole range, in addition to those close to the fitted value.
    """
    grid = np.unique(np.r_[np.linspace(-_MAX_BETA_RAD, _MAX_BETA_RAD, points), _near(fitted, points)])
    at = int(np.argmin(np.abs(grid - fitted.theta[BETA])))
    swept: dict[int, Minimum] = {}
    for side in (range(at, len(grid)), range(at - 1, -1, -1)):
        theta = fitted.theta.copy()
        for i in side:
            theta[BETA] = grid[i]
            swept[i] = _at_fixed(fitted, theta, priors)
            theta = swept[i].theta.copy()
            if swept[i].cost - fitted.solution.minimum.cost > 20 * stretch**2:
                break
    minima = [swept[i] for i in sorted(swept)]
    betas = np.array([m.theta[BETA] for m in minima])
    least = min(m.cost for m in minima)
    excess = np.array([m.cost - least for m in minima]) / stretch**2
    return _profile(minima, betas, excess, stretch)


def _near(fitted: FittedDecay, points: int) -> np.ndarray:
    """Values of β around the fitted value, in steps of half its standard deviation."""
    std = float(np.sqrt(fitted.solution.minimum.covariance[BETA, BETA]))
    values = fitted.theta[BETA] + 0.5 * min(std, _MAX_BETA_RAD) * np.linspace(-7, 7, points // 2 | 1)
    return values[np.abs(values) <= _MAX_BETA_RAD]


def _at_fixed(fitted: FittedDecay, theta: np.ndarray, priors: Priors) -> Minimum:
    centre = np.zeros(len(theta))
    centre[BETA] = theta[BETA]
    std = prior_std(fitted.model, priors)
    std[BETA] = 1e-7
    return solve_separable(fitted.model, theta, centre, std, max_iterations=_MAX_ITERATIONS).minimum


def _profile(minima: list[Minimum], betas: np.ndarray, excess: np.ndarray, stretch: float) -> Profile:
    values = np.array([m.theta[:_MAPPED] for m in minima])
    stds = np.array([np.sqrt(np.diag(m.covariance)[:_MAPPED]) for m in minima]) * stretch
    fine = np.linspace(float(betas[0]), float(betas[-1]), 40 * len(betas))
    level: np.ndarray = np.interp(fine, betas, excess)
    inside = level <= _CHI2_95
    room = np.sqrt(np.maximum(_CHI2_95 - level[inside], 0.0))
    low, high = np.empty(_MAPPED), np.empty(_MAPPED)
    weight = np.exp(-0.5 * level)
    weight /= weight.sum()
    curves: np.ndarray = np.column_stack([np.interp(fine, betas, values[:, j]) for j in range(_MAPPED)])
    spread: np.ndarray = np.column_stack([np.interp(fine, betas, stds[:, j]) for j in range(_MAPPED)])
    for j in range(_MAPPED):
        low[j] = np.min(curves[inside, j] - room * spread[inside, j])
        high[j] = np.max(curves[inside, j] + room * spread[inside, j])
    off = curves - weight @ curves
    own = sum(w * m.covariance[:_MAPPED, :_MAPPED] for w, m in zip(_shares(betas, excess), minima, strict=True))
    closed = bool(level[0] > _CHI2_95 and level[-1] > _CHI2_95)
    return Profile(low, high, own * stretch**2 + off.T @ (weight[:, None] * off), closed)


def _shares(betas: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Likelihood times width of each value of β, normalised to a sum of one."""
    weight = np.exp(-0.5 * excess) * (np.gradient(betas) if len(betas) > 1 else 1.0)
    return weight / weight.sum()


def profile_parameter(fitted: FittedDecay, priors: Priors, index: int, stretch: float = 1.0) -> tuple[float, float]:
    """Profile-likelihood interval (95 %) of one parameter. The others are fitted again at each end.

    Args:
        fitted: solved fit.
        priors: priors of the fit.
        index: index of the parameter in θ.
        stretch: factor on standard deviations for noise above white noise.
    """
    least, centre = fitted.solution.minimum.cost, fitted.theta[index]
    std = float(np.sqrt(fitted.solution.minimum.covariance[index, index]))
    ends: list[float] = []
    for side in (-1.0, 1.0):
        step = side * np.sqrt(_CHI2_95) * stretch * std
        for _ in range(4):  # χ² is nearly a parabola: rescaled steps converge within 0.1 %
            rise = max(_held_cost(fitted, priors, index, centre + step) - least, 1e-9)
            step *= float(np.clip(np.sqrt(_CHI2_95 * stretch**2 / rise), 0.5, 2.0))
        ends.append(centre + step)
    return ends[0], ends[1]


def _held_cost(fitted: FittedDecay, priors: Priors, index: int, value: float) -> float:
    centre, std = np.zeros(fitted.model.size), prior_std(fitted.model, priors)
    unit = float(np.sqrt(fitted.solution.minimum.covariance[index, index]))
    centre[index], std[index] = value, 1e-6 * unit
    theta = fitted.theta.copy()
    theta[index] = value
    return solve_separable(fitted.model, theta, centre, std, max_iterations=_MAX_ITERATIONS).minimum.cost
