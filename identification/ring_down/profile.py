"""Profile likelihood of a turned pair: intervals where the axis angle is so uncertain that Wald's are not safe.

When both directions ring nearly alike, χ² as a function of β is a long curved valley. β is swept; at each value the
other parameters are fitted anew and are there as good as Gaussian, so a parameter q has at β the likelihood interval
q(β) ± sd(β) sqrt(3.84 − ΔX(β)); the union over β is its profile interval. The likelihood's mean and spread over β give
the covariance that a joint estimate can use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Minimum, solve_separable
from identification.ring_down.decay import Fitted, Priors, prior_std
from identification.ring_down.model import BETA

_LIMIT = 3.8415  # 95 % of χ² with one degree of freedom
_REACH = np.radians(44.0)
_MAPPED = BETA + 1
_STEPS = 10


@dataclass(frozen=True)
class Profile:
    """Intervals and spread over β.

    Attributes:
        low, high: of (ln ω1, ζ1, ln ω2, ζ2, β), shape (5,).
        covariance: of the same, shape (5, 5), the spread of q(β) over the likelihood added to that at a fixed β.
        closed: whether β's interval ends inside ±44°.
    """

    low: np.ndarray
    high: np.ndarray
    covariance: np.ndarray
    closed: bool


def profile_axis(fitted: Fitted, priors: Priors, stretch: float = 1.0, points: int = 15) -> Profile:
    """Sweep β over ±44° from the fit's own value to both sides.

    Args:
        stretch: noise above white, as a factor of standard deviations.
        points: values of β.
    """
    grid = np.unique(np.r_[np.linspace(-_REACH, _REACH, points), _near(fitted, points)])
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


def _near(fitted: Fitted, points: int) -> np.ndarray:
    """Values of β around the fit's own, in steps of half its standard deviation."""
    std = float(np.sqrt(fitted.solution.minimum.covariance[BETA, BETA]))
    values = fitted.theta[BETA] + 0.5 * min(std, _REACH) * np.linspace(-7, 7, points // 2 | 1)
    return values[np.abs(values) <= _REACH]


def _at_fixed(fitted: Fitted, theta: np.ndarray, priors: Priors) -> Minimum:
    centre = np.zeros(len(theta))
    centre[BETA] = theta[BETA]
    std = prior_std(fitted.model, priors)
    std[BETA] = 1e-7
    return solve_separable(fitted.model, theta, centre, std, max_iterations=_STEPS).minimum


def _profile(minima: list[Minimum], betas: np.ndarray, excess: np.ndarray, stretch: float) -> Profile:
    values = np.array([m.theta[:_MAPPED] for m in minima])
    stds = np.array([np.sqrt(np.diag(m.covariance)[:_MAPPED]) for m in minima]) * stretch
    fine = np.linspace(betas[0], betas[-1], 40 * len(betas))
    level = np.interp(fine, betas, excess)
    inside = level <= _LIMIT
    room = np.sqrt(np.maximum(_LIMIT - level[inside], 0.0))
    low, high = np.empty(_MAPPED), np.empty(_MAPPED)
    weight = np.exp(-0.5 * level)
    weight /= weight.sum()
    curves = np.column_stack([np.interp(fine, betas, values[:, j]) for j in range(_MAPPED)])
    spread = np.column_stack([np.interp(fine, betas, stds[:, j]) for j in range(_MAPPED)])
    for j in range(_MAPPED):
        low[j] = np.min(curves[inside, j] - room * spread[inside, j])
        high[j] = np.max(curves[inside, j] + room * spread[inside, j])
    off = curves - weight @ curves
    own = sum(w * m.covariance[:_MAPPED, :_MAPPED] for w, m in zip(_shares(betas, excess), minima, strict=True))
    closed = bool(level[0] > _LIMIT and level[-1] > _LIMIT)
    return Profile(low, high, own * stretch**2 + off.T @ (weight[:, None] * off), closed)


def _shares(betas: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Likelihood times width of each value of β, summing to one."""
    weight = np.exp(-0.5 * excess) * (np.gradient(betas) if len(betas) > 1 else 1.0)
    return weight / weight.sum()


def profile_parameter(fitted: Fitted, priors: Priors, index: int, stretch: float = 1.0) -> tuple[float, float]:
    """One parameter's profile-likelihood interval (95 %), the others fitted anew at each end.

    Args:
        index: place in θ.
        stretch: noise above white, as a factor of standard deviations.
    """
    least, centre = fitted.solution.minimum.cost, fitted.theta[index]
    std = float(np.sqrt(fitted.solution.minimum.covariance[index, index]))
    ends = []
    for side in (-1.0, 1.0):
        step = side * np.sqrt(_LIMIT) * stretch * std
        for _ in range(4):  # χ² is nearly a parabola, so a rescaled step lands within a per mille
            rise = max(_held_cost(fitted, priors, index, centre + step) - least, 1e-9)
            step *= float(np.clip(np.sqrt(_LIMIT * stretch**2 / rise), 0.5, 2.0))
        ends.append(centre + step)
    return ends[0], ends[1]


def _held_cost(fitted: Fitted, priors: Priors, index: int, value: float) -> float:
    centre, std = np.zeros(fitted.model.size), prior_std(fitted.model, priors)
    unit = float(np.sqrt(fitted.solution.minimum.covariance[index, index]))
    centre[index], std[index] = value, 1e-6 * unit
    theta = fitted.theta.copy()
    theta[index] = value
    return solve_separable(fitted.model, theta, centre, std, max_iterations=_STEPS).minimum.cost
