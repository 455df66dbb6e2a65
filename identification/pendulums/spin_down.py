"""Spin-down on a rotor at rest: a pendulum's damping from the decay of its speed.

θ = θ0 + A e^{−λt} with λ = c/J, fitted up to 4.5 time constants: in the standstill tail the encoder's error is one
constant of up to half a step and not noise, which makes intervals too short. Dry friction adds a column linear in
time as long as the pendulum moves; an F test looks for it. The disk's reaction is left out here: it enters in
identification.pendulums.transient, which starts from this fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from identification.curve import Curve
from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Block, solve_separable
from identification.samples import Averages, block_averages, correlation_inflation, encoder_noise

BLOCK_S = 0.008
TIME_CONSTANTS = 4.5
_SPEED_S = 0.04  # speeds are differences over this span, so that the encoder's steps do not matter
_SETTLED_S = 0.03  # left out after the hand has let go


@dataclass(frozen=True)
class SpinDownFit:
    """What one pendulum's spin-down says.

    Attributes:
        values: rate_per_s (λ), start_speed_rad_s; with an inertia c_Nms_per_rad.
        covariance: shape (n, n), in the values' order.
        friction_p: chance of a friction term this large without friction.
        warnings: what a reader must know.
        curve: the fitted stretch.
        start_s, end_s: that stretch.
        chi2_per_dof: residuals against the encoder's white noise.
    """

    values: dict[str, float]
    covariance: np.ndarray
    friction_p: float
    warnings: list[str]
    curve: Curve
    start_s: float
    end_s: float
    chi2_per_dof: float

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


@dataclass(frozen=True)
class Decline:
    """The stretch of a record in which a pendulum runs down, the log-speed line through it, and when its push began."""

    push_s: float
    start_s: float
    end_s: float
    rate_per_s: float
    speed_rad_s: float


def fit_spin_down(time_s: np.ndarray, angle_rad: np.ndarray, inertia_kg_m2: float | None = None) -> SpinDownFit:
    """Fit one pendulum's run-down on a rotor at rest.

    Args:
        time_s, angle_rad: shape (n,); unwrapped angle relative to the rotor; NaN is left out. What comes before the
            fastest instant is ignored.
        inertia_kg_m2: J; adds the damping c = λ J.
    Raises:
        NotIdentifiable: the pendulum hardly moves, or stops within too few samples.
        FitFailed: no convergence.
    Source: docs/theory/identification.md.
    """
    whole = angle_averages(np.asarray(time_s, float), np.asarray(angle_rad, float))
    decline = find_decline(whole)
    data = whole.between(decline.start_s, decline.end_s)
    t, weight = data.time_s - decline.start_s, data.weight

    def basis(rate: float, friction: bool) -> np.ndarray:
        columns = [np.ones_like(t), np.exp(-rate * t) * (1 + 0.5 * data.spread_s2 * rate**2)]
        return np.column_stack([*columns, t] if friction else columns) * weight[:, None]

    def model(friction: bool):
        def at(theta: np.ndarray) -> list[Block]:
            rate = float(np.exp(theta[0]))

            def tangent(c: np.ndarray) -> np.ndarray:
                curved = 1 + 0.5 * data.spread_s2 * rate**2
                moved = np.exp(-rate * t) * (data.spread_s2 * rate**2 - rate * t * curved)
                return (moved * c[1] * weight)[:, None]

            return [Block(data.value * weight, basis(rate, friction), tangent)]

        return at

    start, free = np.log([decline.rate_per_s]), np.array([np.inf])
    viscous = solve_separable(model(False), start, start, free)
    dry = solve_separable(model(True), viscous.minimum.theta, start, free)
    if not viscous.minimum.converged:
        raise FitFailed(f"spin-down: no convergence, χ²/dof {viscous.chi2_per_dof:.3g}")
    residual = viscous.residuals[0]
    correlation = correlation_inflation(residual)
    friction_p = _friction_p(viscous.minimum.cost, dry.minimum.cost, len(t), correlation)
    rate = float(np.exp(viscous.minimum.theta[0]))
    amplitude = float(viscous.coefficients[0][1])
    jacobian = np.array([[rate, 0, 0], [-amplitude * rate, 0, -rate]])
    inflation = max(correlation, np.sqrt(max(1.0, viscous.chi2_per_dof)))
    covariance = jacobian @ viscous.coefficient_covariances[0] @ jacobian.T * inflation**2
    values = {"rate_per_s": rate, "start_speed_rad_s": -amplitude * rate}
    if inertia_kg_m2 is not None:
        values["c_Nms_per_rad"] = rate * inertia_kg_m2
        grow = np.array([[1, 0], [0, 1], [inertia_kg_m2, 0]])
        covariance = grow @ covariance @ grow.T
    warnings = []
    if friction_p < 1e-3:
        warnings.append(
            f"the run-down is not purely viscous (p = {friction_p:.1g}): dry friction or the disk's reaction; "
            "compare a faster start"
        )
    metres = residual / weight
    curve = Curve("spin-down", "rad", data.time_s, data.value, data.value - metres)
    return SpinDownFit(
        values, covariance, friction_p, warnings, curve, decline.start_s, decline.end_s, viscous.chi2_per_dof
    )


def _friction_p(cost: float, cost_with: float, n: int, correlation: float) -> float:
    """F test of one more column, with correlated residuals counting for fewer independent ones."""
    effective = max(5.0, n / correlation**2)
    ratio = max(cost - cost_with, 0.0) / max(cost_with, 1e-300) * (effective - 4)
    return float(f_distribution.sf(ratio, 1, effective - 4))


def angle_averages(time_s: np.ndarray, angle_rad: np.ndarray) -> Averages:
    """Block averages of one encoder; the noise is taken where the pendulum moves, so that steps are dithered."""
    good = np.isfinite(angle_rad)
    if np.count_nonzero(good) < 200:
        raise NotIdentifiable(f"{np.count_nonzero(good)} valid encoder samples are too few")
    t, angle = time_s[good], angle_rad[good]
    steps = np.abs(np.diff(angle))
    smallest = float(np.min(steps[steps > 1e-12])) if np.any(steps > 1e-12) else 1e-6
    return block_averages(t, angle, BLOCK_S, encoder_noise(angle, smallest))


def find_decline(angle: Averages) -> Decline:
    """The run-down after the last push, and the rate of its log-speed line.

    Raises:
        NotIdentifiable: no motion worth the name, or the speed does not fall.
    """
    stride = max(1, round(_SPEED_S / float(np.median(np.diff(angle.time_s)))))
    t = 0.5 * (angle.time_s[stride:] + angle.time_s[:-stride])
    speed = np.abs((angle.value[stride:] - angle.value[:-stride]) / (angle.time_s[stride:] - angle.time_s[:-stride]))
    peak = int(np.argmax(speed))
    travel = float(np.ptp(angle.value[np.searchsorted(angle.time_s, t[peak]) :]))
    if travel < 300 * angle.noise:
        raise NotIdentifiable(f"the pendulum travels only {travel:.2g} rad; flick it harder")
    start = t[peak] + 0.5 * _SPEED_S + _SETTLED_S
    slow = np.flatnonzero((t > t[peak]) & (speed < 0.1 * speed[peak]))
    end = t[slow[0]] if len(slow) else t[-1]
    line = (t >= start) & (t <= end) & (speed > 0)
    if np.count_nonzero(line) < 10:
        raise NotIdentifiable("the pendulum stops within a few samples of its push")
    slope, _ = np.polyfit(t[line] - start, np.log(speed[line]), 1)
    if slope >= 0:
        raise NotIdentifiable("the pendulum's speed does not fall")
    last = min(float(angle.time_s[-1]), float(start - TIME_CONSTANTS / slope))
    slow = np.flatnonzero(speed[: peak + 1] < 0.05 * speed[peak])
    push = t[slow[-1]] if len(slow) else angle.time_s[0]
    return Decline(float(push), float(start), last, float(-slope), float(speed[peak]))
