"""A pendulum running down on a rotor at rest: viscous and dry friction in closed form, fitted by least squares.

    J θ̈ = −c θ̇ − M_c sign θ̇,     λ = c/J,   h = M_c/(c v0)
    θ = θ0 + v0 (((1 + h)/λ)(1 − e^{−λt}) − h t)   until it stops at t = ln(1 + 1/h)/λ

h is the share of dry friction in the first instant's torque. A negative h never stops and means nothing; it is kept in
the model so that the estimate of h is not biased and a test of h > 0 is honest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Minimum, minimise

VISCOUS, WITH_FRICTION = 3, 4


@dataclass(frozen=True)
class RunDown:
    """The samples of one decline.

    Attributes:
        time_s: since the decline's start, shape (n,).
        angle_rad: shape (n,).
        noise_rad: standard deviation of a sample.
        step_rad: the encoder's step; 0 when the angle is not quantised.
    """

    time_s: np.ndarray
    angle_rad: np.ndarray
    noise_rad: float
    step_rad: float

    def where(self, keep: np.ndarray) -> RunDown:
        """The samples for which keep, shape (n,), is true."""
        return RunDown(self.time_s[keep], self.angle_rad[keep], self.noise_rad, self.step_rad)

    def until(self, end_s: float) -> RunDown:
        """The samples up to an instant."""
        return self.where(self.time_s <= end_s)


def stop_time(rate: float, share: float) -> float:
    """When friction brings the pendulum to rest, s after the start; inf without friction."""
    return float(np.log1p(1 / share) / rate) if share > 0 else np.inf


def run_down_angle(time_s: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The angle and its derivatives.

    Args:
        time_s: shape (n,).
        theta: θ0, v0, ln λ and, if given, h.
    Returns:
        Angle (n,), derivatives by theta (n, 4).
    """
    start, speed, rate = theta[0], theta[1], float(np.exp(theta[2]))
    share = float(theta[3]) if len(theta) == WITH_FRICTION else 0.0
    t = np.minimum(time_s, stop_time(rate, share))  # at the stop the speed is 0, so its instant's shift does not enter
    fallen = -np.expm1(-rate * t) / rate
    shape = (1 + share) * fallen - share * t
    by_rate = speed * (1 + share) * (t * np.exp(-rate * t) - fallen)  # λ ∂/∂λ
    return start + speed * shape, np.column_stack([np.ones_like(t), shape, by_rate, speed * (fallen - t)])


def fit_run_down(data: RunDown, start: np.ndarray, iterations: int = 30) -> Minimum:
    """Least squares on one decline.

    Args:
        start: θ0, v0, ln λ and, for a fit with friction, h.
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle, jacobian = run_down_angle(data.time_s, theta)
        return (angle - data.angle_rad) / data.noise_rad, jacobian[:, : len(theta)] / data.noise_rad

    return minimise(evaluate, start, iterations)
