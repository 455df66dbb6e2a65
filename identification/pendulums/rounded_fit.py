"""Least squares on a run-down, with a covariance that includes the encoder's rounding and the model's misfit.

The length of the stretch is selected. A longer one contains more information while rounding acts as noise, and less
otherwise. The selection uses quantised copies of the fitted curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.errors import FitFailed
from identification.least_squares import Minimum, inverse_normal
from identification.pendulums.quantiser import rounding_errors
from identification.pendulums.run_down import RunDown, fit_run_down, run_down_angle
from identification.samples import correlation_inflation
from identification.setting import Setting
from rig_basics.texts import number_of

TIME_CONSTANTS = 5.0
"""Default length of a stretch in time constants."""
_STRETCHES = (4.5, 5.0, 5.5, 6.0, 7.0, 8.0)  # candidate lengths in time constants
_ROUNDED = {"fast": 0, "balanced": 1_500_000, "reference": 4_000_000}  # number of readings for the quantiser


@dataclass(frozen=True)
class FittedRunDown:
    """Fit of one model on one stretch.

    Attributes:
        data: samples of the stretch.
        theta: θ0, v0, ln λ and, with dry friction, h.
        covariance: covariance of theta, including rounding and misfit.
        chi2_per_dof: χ²/dof against the encoder's noise.
        inflation: factor on the standard deviations by misfit.
    """

    data: RunDown
    theta: np.ndarray
    covariance: np.ndarray
    chi2_per_dof: float
    inflation: float

    @property
    def cost(self) -> float:
        """Sum of squared residuals in noise standard deviations."""
        return self.chi2_per_dof * max(1, len(self.data.time_s) - len(self.theta))


def cut(data: RunDown, theta: np.ndarray, time_constants: float = TIME_CONSTANTS) -> RunDown:
    """Return the stretch of the given number of time constants."""
    return data.until(time_constants * float(np.exp(-theta[2])))


def rounded_fit(data: RunDown, start: np.ndarray, setting: Setting) -> FittedRunDown:
    """Fit the stretch with the smallest variance of the damping; its covariance includes rounding and misfit."""
    minimum = _converged(cut(data, start), start)
    first = cut(data, start)
    if not (data.step_rad and _ROUNDED[setting]):
        return _with_misfit(first, minimum, minimum.covariance, 1.0)
    longest = cut(data, minimum.theta, max(_STRETCHES))
    draws = int(np.clip(_ROUNDED[setting] / len(longest.time_s), 150, 1000))
    errors = _rounding(longest, first, minimum, draws)
    best = None
    for time_constants in _STRETCHES:
        part = cut(longest, minimum.theta, time_constants)
        n = len(part.time_s)
        if best is not None and n == len(best[0].time_s):
            continue
        jacobian = run_down_angle(part.time_s, minimum.theta)[1][:, : len(start)] / data.noise_rad
        covariance, white = _through_the_quantiser(jacobian, errors[:, :n])
        if best is None or covariance[2, 2] < best[1][2, 2]:
            best = part, covariance, white
    assert best is not None
    part, covariance, white = best
    return _with_misfit(part, _converged(part, minimum.theta), covariance, white)


def plain_fit(data: RunDown, start: np.ndarray) -> FittedRunDown:
    """Fit all given samples with rounding as noise; a fit that has not converged is returned as well."""
    minimum = fit_run_down(data, start)
    return _with_misfit(data, minimum, minimum.covariance, 1.0)


def _converged(data: RunDown, start: np.ndarray) -> Minimum:
    minimum = fit_run_down(data, start)
    if not minimum.converged:
        raise FitFailed(
            f"spin-down: the fit did not converge in {number_of(minimum.iterations, 'step')}, χ²/dof "
            f"{minimum.cost / len(data.time_s):.3g}; record again"
        )
    return minimum


def _rounding(longest: RunDown, fitted: RunDown, minimum: Minimum, draws: int) -> np.ndarray:
    """Return rounding errors of curves near the fitted one, in noise standard deviations, shape (draws, n).

    The jitter is the residual in excess of rounding. Curves are drawn from the fit's covariance, because the position
    of the standstill within a step is unknown.
    """
    spread = minimum.cost / max(1, len(fitted.time_s) - len(minimum.theta)) * longest.noise_rad**2
    jitter = float(np.sqrt(np.clip(spread - longest.step_rad**2 / 12, 0.0, longest.noise_rad**2)))
    angle, jacobian = run_down_angle(longest.time_s, minimum.theta)
    none = np.zeros(len(minimum.theta))
    # the covariance is semidefinite except for rounding errors, which are large in a direction without information
    moves = np.random.default_rng(2).multivariate_normal(none, minimum.covariance, draws, check_valid="ignore")
    curves = angle + moves @ jacobian[:, : len(minimum.theta)].T
    return rounding_errors(curves, longest.step_rad, jitter, 1) / longest.noise_rad


def _through_the_quantiser(jacobian: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the covariance of the least-squares estimate for such errors, and the correlation of their residuals.

    Without jitter the errors of the estimate are bounded, and 95 % of them lie within less than 1.96 standard
    deviations. The covariance is scaled so that 1.96 of its standard deviations contain 95 % of the rate's errors.
    """
    wrong = errors @ (jacobian @ inverse_normal(jacobian))
    white = max(correlation_inflation(e - jacobian @ w) for e, w in zip(errors[:20], wrong, strict=False))
    spread = wrong.T @ wrong / len(wrong)
    reach = float(np.quantile(np.abs(wrong[:, 2]), 0.95)) / (1.96 * np.sqrt(spread[2, 2]))
    return spread * reach**2, white


def _with_misfit(data: RunDown, minimum: Minimum, covariance: np.ndarray, white: float) -> FittedRunDown:
    """Return the fit with its covariance stretched by residuals that are larger or more correlated than by rounding."""
    n = len(data.time_s)
    chi2 = minimum.cost / max(1, n - len(minimum.theta))
    together = max(1.0, correlation_inflation(minimum.residual) / white)
    inflation = together * float(np.sqrt(max(1.0, chi2 / (1 + 3 / np.sqrt(n)))))
    return FittedRunDown(data, minimum.theta, covariance * inflation**2, chi2, inflation)
