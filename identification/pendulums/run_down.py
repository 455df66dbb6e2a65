"""Run-down of a pendulum on a rotor at rest: viscous damping and dry friction in closed form, fitted by least squares.

    J θ̈ = −c θ̇ − M_c sign θ̇,     λ = c/J,   h = M_c/(c v0)
    θ = θ0 + v0 (((1 + h)/λ)(1 − e^{−λt}) − h t)   until it stops at t = ln(1 + 1/h)/λ

h is the ratio of dry friction to viscous torque at the first instant. With a negative h, which has no physical meaning,
the pendulum never stops. It is allowed in the model so that the estimate of h and the test of h > 0 are unbiased.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Minimum, inverse_normal, minimise

VISCOUS, WITH_FRICTION = 3, 4
_MAX_LINEAR_SHARE = 0.2  # share of dry friction up to which h and ln λ are the coordinates of the fit
_SHORT = 1e-3  # time in time constants below which a series is more exact


@dataclass(frozen=True)
class RunDown:
    """Samples of one run-down.

    Attributes:
        time_s: time since the start of the run-down, s, shape (n,).
        angle_rad: angle, rad, shape (n,).
        noise_rad: standard deviation of a sample, rad.
        step_rad: quantisation step of the encoder, rad; 0 if the angle is not quantised.
    """

    time_s: np.ndarray
    angle_rad: np.ndarray
    noise_rad: float
    step_rad: float

    def where(self, keep: np.ndarray) -> RunDown:
        """Return the samples for which keep, shape (n,), is true."""
        return RunDown(self.time_s[keep], self.angle_rad[keep], self.noise_rad, self.step_rad)

    def until(self, end_s: float) -> RunDown:
        """Return the samples up to an instant."""
        return self.where(self.time_s <= end_s)


def stop_time(rate: float, share: float) -> float:
    """Return the time from the start to the stop by friction, s; inf without friction."""
    return float(np.log1p(1 / share) / rate) if share > 0 else np.inf


def run_down_angle(time_s: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle and its derivatives.

    Args:
        time_s: time since the start, s, shape (n,).
        theta: θ0, v0, ln λ and, if given, h.
    Returns:
        Angle (n,), derivatives by theta (n, 4).
    """
    start, speed, rate = theta[0], theta[1], float(np.exp(theta[2]))
    share = float(theta[3]) if len(theta) == WITH_FRICTION else 0.0
    t = np.minimum(time_s, stop_time(rate, share))  # the stop's derivative has no effect: the speed is 0
    x = rate * t
    # 1 − (1 − e^{−x})/x, by its series for small x, because its product with a large friction share matters
    series, whole = x * (1 / 2 - x * (1 / 6 - x * (1 / 24 - x / 120))), np.maximum(x, _SHORT)
    lost = np.where(x < _SHORT, series, 1 + np.expm1(-whole) / whole)
    shape = t * (1 - lost) - share * t * lost
    by_rate = speed * (1 + share) * t * (np.expm1(-x) + lost)  # λ ∂/∂λ
    return start + speed * shape, np.column_stack([np.ones_like(t), shape, by_rate, -speed * t * lost])


def from_stop(data: RunDown) -> np.ndarray | None:
    """Return start values θ0, v0, ln λ, h from the instant of the stop; None if the record does not contain the stop.

    With u = ln(1 + 1/h) the travel over v0 t_stop is 1/u − h. It is between 0 for little dry friction and one half for
    dry friction alone.
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
    """Fit one run-down by least squares.

    Args:
        data: samples.
        start: start values of θ0, v0, ln λ and, for a fit with friction, h.
        iterations: largest number of iterations.
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a step that is too long is refused
            angle, jacobian = run_down_angle(data.time_s, theta)
            return (angle - data.angle_rad) / data.noise_rad, jacobian[:, : len(theta)] / data.noise_rad

    if len(start) < WITH_FRICTION or start[3] < _MAX_LINEAR_SHARE:
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
    """Return θ0, v0, ln λ, h from θ0, v0, ln λ, ln λ(1 + h); with large friction only the last is well determined."""
    return np.r_[moved[:3], np.expm1(np.clip(moved[3] - moved[2], -50.0, 50.0))]


def _torque_slope(moved: np.ndarray) -> np.ndarray:
    slope, torque = np.eye(4), float(np.exp(np.clip(moved[3] - moved[2], -50.0, 50.0)))
    slope[3, 2:] = -torque, torque
    return slope
