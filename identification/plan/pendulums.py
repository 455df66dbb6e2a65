"""Spin-down and release as a plan sees them: the nonlinear motion of disk and pendulums, encoders with zeros.

Written apart from the estimators: own parameters, own instants, central differences.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import fastest_rate, integrate, locked_state
from identification.estimate import Estimate
from identification.methods import Method
from identification.plan.experiment import Experiment
from identification.plan.information import covariance, derivatives
from identification.plan.sensors import Sensors

_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_LOOK_S = 0.004  # between the instants looked at
_KNOWN = np.array([1e-4, 1e-4, 1e-3, 1e-3, 1e-3])  # ln k1, k2, ζ1, ζ2, S_P: as ring-downs and a run-up leave them
_SHAKEN_M = 3e-4  # how far a flick may leave the disk moving
_LOCKED_M = 2e-5  # how far the disk may be from its locked orbit
_RELEASE_STD_S = 1e-3
_LOCKED_RAD = np.radians([0.1, 179.85])  # a real lock has play: exactly at 0° and 180° a pendulum may stay
_HAND_S = 0.05  # after a flick the hand is still there
_ASTRAY = 0.7  # rotor phase of a spin-down, rad; between the axes, where both directions take part


def spin_down(
    physics: RotorParameters, sensors: Sensors, speed_rad_s: float, record_s: float, test: str = "spin-down"
) -> Experiment:
    """Both pendulums flicked on a resting rotor, against each other.

    Args:
        speed_rad_s: right after the flick.
        record_s: length after the flicks. Beyond 4.5 time constants nothing is used: at rest quantisation is no noise.
    """
    slowest = min(p.damping_Nms_per_rad / p.inertia_kg_m2 for p in (physics.a, physics.b))
    used = min(record_s, 4.5 / slowest)
    begin = [
        speed_rad_s * float(np.exp(-p.damping_Nms_per_rad / p.inertia_kg_m2 * _HAND_S)) for p in (physics.a, physics.b)
    ]
    grid = _grid(used)
    step = 0.3 / fastest_rate(physics, 0.0)
    omega = np.array(physics.natural_frequencies_rad_s)

    def angles(theta: np.ndarray) -> np.ndarray:
        now = _laid_over(physics, np.r_[theta[:2], theta[11:15], 0.0])
        history = SpeedHistory.constant(0.0, float(theta[6]))
        state = np.r_[theta[7:9], theta[2:4], theta[9:11], theta[4:6]]
        return _angles(integrate(state, grid, step, history.knots_s, history.coefficients, now.packed(), 1.0, 1.0))

    theta = np.r_[0.0, 0.0, 0.0, np.pi, begin[0], -begin[1], _ASTRAY, np.zeros(8)]
    difference = np.r_[np.full(2, 1e-4), np.full(5, 1e-4), 1e-6, 1e-6, 1e-6 * omega, np.full(4, 1e-4)]
    prior = np.full(15, np.inf)
    prior[7:11] = np.r_[_SHAKEN_M, _SHAKEN_M, _SHAKEN_M * omega]
    prior[11:] = _KNOWN[:4]
    settings = {"flick_rad_per_s": speed_rad_s, "record_s": record_s}
    return _experiment(test, "spin-down", physics, sensors, angles, theta, difference, prior, settings, record_s, used)


def release(physics: RotorParameters, sensors: Sensors, test: str, speed_rad_s: float, record_s: float) -> Experiment:
    """Both pendulums let go at constant speed.

    Args:
        test: what the test is called, "point-E".
        speed_rad_s: running speed.
        record_s: length after the release.
    """
    grid = _grid(record_s)
    step = 0.12 / fastest_rate(physics, speed_rad_s)
    history = SpeedHistory.constant(speed_rad_s)
    omega = physics.natural_frequencies_rad_s[0]

    def angles(theta: np.ndarray) -> np.ndarray:
        now = _laid_over(physics, np.r_[theta[:2], theta[11:16]])
        true, late = theta[2:4] - theta[4:6], float(theta[6])
        start = locked_state(now, speed_rad_s, speed_rad_s * late, *true)
        start[[0, 1, 4, 5]] += theta[7:11]
        span = np.r_[late, late + grid[1:]]
        states = integrate(start, span, step, history.knots_s, history.coefficients, now.packed(), 1.0, 1.0)
        # a shift of the release moves the motion against the instants looked at
        moved = states[1:, 2:4] - late * states[1:, 6:8]
        return (moved + theta[4:6]).T.ravel()

    theta = np.r_[0.0, 0.0, _LOCKED_RAD, np.zeros(12)]
    difference = np.r_[np.full(6, 1e-6), 1e-6, 1e-8, 1e-8, 1e-8 * omega, 1e-8 * omega, np.full(5, 1e-6)]
    quarter = 0.25 * sensors.encoder_step_rad  # what a mean of quantised readings of a locked pendulum leaves open
    zero = sensors.encoder_zero_std_rad
    prior = np.r_[
        np.inf,
        np.inf,
        quarter,
        quarter,
        zero,
        zero,
        _RELEASE_STD_S,
        _LOCKED_M,
        _LOCKED_M,
        _LOCKED_M * omega,
        _LOCKED_M * omega,
        _KNOWN,
    ]
    settings = {"speed_rpm": speed_rad_s * 30 / np.pi, "record_s": record_s}
    return _experiment(
        test, "release", physics, sensors, angles, theta, difference, prior, settings, record_s, record_s
    )


def _experiment(
    test: str,
    method: Method,
    physics: RotorParameters,
    sensors: Sensors,
    angles: Callable[[np.ndarray], np.ndarray],
    theta: np.ndarray,
    difference: np.ndarray,
    prior: np.ndarray,
    settings: dict[str, float],
    record_s: float,
    used_s: float,
) -> Experiment:
    jacobian = derivatives(angles, theta, difference)
    weight = np.sqrt(sensors.encoder_rate_Hz * _LOOK_S) / sensors.encoder_noise_rad
    values = np.array([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad])
    own = covariance(jacobian * weight, prior, 2) * np.outer(values, values)
    shared = sensors.clock_error("angles", values * sensors.clock_rate_std("angles", record_s))
    remarks = ("the suspension is taken as known from ring-downs: k to 0.01 %, ζ and S_P to 0.1 %",)
    if used_s < record_s:
        remarks += (f"only the first {used_s:.2g} s tell: 4.5 time constants",)
    expected = Estimate(test, "planned", _NAMES, values, own, shared, "Fisher information")
    return Experiment(test, method, settings, record_s, expected, remarks=remarks)


def _grid(record_s: float) -> np.ndarray:
    return np.arange(0.0, record_s, _LOOK_S)


def _angles(states: np.ndarray) -> np.ndarray:
    return states[1:, 2:4].T.ravel()


def _laid_over(physics: RotorParameters, log_change: np.ndarray) -> RotorParameters:
    """The rig with c3, c4, k1, k2, ζ1, ζ2, S_P changed by factors."""
    names = (*_NAMES, "k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
    believed = physics.identified()
    return physics.with_values(
        **{n: believed[n] * float(np.exp(change)) for n, change in zip(names, log_change, strict=True)}
    )
