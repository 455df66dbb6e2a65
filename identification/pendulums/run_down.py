"""A pendulum running down on a rotor at rest: viscous and dry friction in closed form, fitted by least squares.

    J θ̈ = −c θ̇ − M_c sign θ̇,     λ = c/J,   h = M_c/(c v0)
    θ = θ0 + v0 (((1 + h)/λ)(1 − e^{−λt}) − h t)   until it stops at t = ln(1 + 1/h)/λ

h is the share of dry friction in the first instant's torque. A negative h never stops and means nothing; it is kept in
the model so that the estimate of h is not biased and a test of h > 0 is honest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Minimum, inverse_normal, minimise

VISCOUS, WITH_FRICTION = 3, 4
_STRAIGHT = 0.2  # share of dry friction up to which h and ln λ are good coordinates
_SHORT = 1e-3  # of a time constant: below it a series is more exact


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
    x = rate * t
    # 1 − (1 − e^{−x})/x, by its series where that cancels: beside much friction its product with the share counts
    series, whole = x * (1 / 2 - x * (1 / 6 - x * (1 / 24 - x / 120))), np.maximum(x, _SHORT)
    lost = np.where(x < _SHORT, series, 1 + np.expm1(-whole) / whole)
    shape = t * (1 - lost) - share * t * lost
    by_rate = speed * (1 + share) * t * (np.expm1(-x) + lost)  # λ ∂/∂λ
    return start + speed * shape, np.column_stack([np.ones_like(t), shape, by_rate, -speed * t * lost])


def from_stop(data: RunDown) -> np.ndarray | None:
    """θ0, v0, ln λ, h from when a pendulum stops; None where it is not seen to stop within the record.

    With u = ln(1 + 1/h) the travel is v0 t_stop (1/u − h): from 0 with little dry friction to one half with nothing
    else.
    """
    t, angle = data.time_s, data.angle_rad
    left, least = np.abs(angle - np.median(angle[-5:])), 3 * data.noise_rad + data.step_rad
    before = [np.flatnonzero(left > level) for level in (4 * least, least)]
    if len(before[0]) == 0 or before[1][-1] >= len(t) - 5:
        return None
    twice, once = (float(t[moves[-1]]) for moves in before)
    stop = 2 * once - twice  # the last of the travel is a parabola
    early = t <= 0.3 * stop
    if np.count_nonzero(early) < 8:
        return None
    at, speed = np.polynomial.Polynomial.fit(t[early], angle[early], 3).convert(domain=[-1, 1]).coef[:2]
    filled = float((np.median(angle[-5:]) - at) / (speed * stop))
    shares = np.geomspace(1e-4, 1e2, 200)
    share = float(np.interp(filled, 1 / np.log1p(1 / shares) - shares, shares))
    return np.r_[at, speed, np.log(np.log1p(1 / share) / stop), share]


def fit_run_down(data: RunDown, start: np.ndarray, iterations: int = 30) -> Minimum:
    """Least squares on one decline.

    Args:
        start: θ0, v0, ln λ and, for a fit with friction, h.
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a step too far: not finite, not taken
            angle, jacobian = run_down_angle(data.time_s, theta)
            return (angle - data.angle_rad) / data.noise_rad, jacobian[:, : len(theta)] / data.noise_rad

    if len(start) < WITH_FRICTION or start[3] < _STRAIGHT:
        return minimise(evaluate, start, iterations)

    def by_torque(moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual, jacobian = evaluate(_from_torque(moved))
        with np.errstate(over="ignore", invalid="ignore"):
            return residual, jacobian @ _torque_slope(moved)

    found = minimise(by_torque, np.r_[start[:3], start[2] + np.log1p(start[3])], iterations)
    theta = _from_torque(found.theta)
    residual, jacobian = evaluate(theta)
    return Minimum(theta, inverse_normal(jacobian), residual, jacobian, found.converged, found.iterations)


def _from_torque(moved: np.ndarray) -> np.ndarray:
    """θ0, v0, ln λ, h from θ0, v0, ln λ, ln λ(1 + h): where friction is large only that sum is well seen."""
    return np.r_[moved[:3], np.expm1(np.clip(moved[3] - moved[2], -50.0, 50.0))]


def _torque_slope(moved: np.ndarray) -> np.ndarray:
    slope, torque = np.eye(4), float(np.exp(np.clip(moved[3] - moved[2], -50.0, 50.0)))
    slope[3, 2:] = -torque, torque
    return slope
