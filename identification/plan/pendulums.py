"""Models of spin-down and release for planning: nonlinear motion of disk and pendulums, encoders with zeros.

The code is independent of the estimators: it has its own parameters and instants, and uses central differences. Dry
friction is unknown in a plan as it is in a fit: it has nearly the same effect as viscous damping, so a plan without it
would promise a fifth of the uncertainty that a spin-down gives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import fastest_rate, integrate, locked_state
from identification.estimate import Estimate
from identification.methods import Method
from identification.pendulums.frictional_motion import frictional_motion
from identification.pendulums.push import TIME_CONSTANTS
from identification.pendulums.release_problem import fitted_until
from identification.plan.experiment import Experiment
from identification.plan.information import covariance, derivatives, friction_columns
from identification.plan.sensors import SensorProperties
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_INSTANT_S = 0.004  # interval between the evaluated instants
# standard deviations of ln k1, k2, ζ1, ζ2, S_P after ring-downs and a run-up
_PRIOR_STD: Array = np.array([1e-4, 1e-4, 1e-3, 1e-3, 1e-3])
_DISK_STD_M = 3e-4  # standard deviation of the disk's displacement after a flick
_LOCKED_STD_M = 2e-5  # standard deviation of the disk's deviation from its locked orbit
_LOCKED_RAD: Array = np.radians([0.1, 179.85])  # a lock has play; at exactly 0° and 180° a pendulum may stay at rest
_HAND_S = 0.05  # time after a flick in which the hand still touches the pendulum
_SPIN_DOWN_PHASE_RAD = 0.7  # rotor phase of a spin-down: between the axes, where both directions move


def spin_down(
    physics: RotorParameters, sensors: SensorProperties, speed_rad_s: float, record_s: float, test: str = "spin-down"
) -> Experiment:
    """Return the spin-down of both pendulums, flicked in opposite directions on a resting rotor.

    Args:
        physics: nominal parameters.
        sensors: sensor properties.
        speed_rad_s: speed of the pendulums right after the flick, rad/s.
        record_s: length after the flicks, s. Samples of a pendulum after 4.5 of its time constants are not used, as in
            the fit, because the quantisation of a pendulum at rest is not white noise.
        test: name of the test.
    """
    moving_s = [TIME_CONSTANTS * p.inertia_kg_m2 / p.damping_Nms_per_rad for p in (physics.a, physics.b)]
    used = min(record_s, max(moving_s))
    begin = [
        speed_rad_s * float(np.exp(-p.damping_Nms_per_rad / p.inertia_kg_m2 * _HAND_S)) for p in (physics.a, physics.b)
    ]
    grid = _grid(used)
    step = 0.3 / fastest_rate(physics, 0.0)
    omega = np.array(physics.natural_frequencies_rad_s)

    def angles(theta: Array) -> Array:
        now = _laid_over(physics, np.r_[theta[:2], theta[11:15], 0.0])
        history = SpeedHistory.constant(0.0, float(theta[6]))
        state = np.r_[theta[7:9], theta[2:4], theta[9:11], theta[4:6]]
        return _angles(integrate(state, grid, step, history.knots_s, history.coefficients, now.packed(), 1.0, 1.0))

    theta = np.r_[0.0, 0.0, 0.0, np.pi, begin[0], -begin[1], _SPIN_DOWN_PHASE_RAD, np.zeros(8)]
    difference = np.r_[np.full(2, 1e-4), np.full(5, 1e-4), 1e-6, 1e-6, 1e-6 * omega, np.full(4, 1e-4)]
    prior = np.full(15, np.inf)
    prior[7:11] = np.r_[_DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega]
    prior[11:] = _PRIOR_STD[:4]
    settings = {"flick_rad_per_s": speed_rad_s, "record_s": record_s}
    friction = _spin_down_friction(physics, grid[1:], begin)
    model = _Model(angles, theta, difference, prior, friction, np.concatenate([grid[1:] <= s for s in moving_s]))
    return _experiment(test, "spin-down", physics, sensors, model, settings, record_s, used)


def release(
    physics: RotorParameters, sensors: SensorProperties, test: str, speed_rad_s: float, record_s: float
) -> Experiment:
    """Return the release of both pendulums at constant speed.

    Args:
        physics: nominal parameters.
        sensors: sensor properties.
        test: name of the test, for example "point-E".
        speed_rad_s: rotor speed, rad/s.
        record_s: length after the release, s.
    """
    step = 0.12 / fastest_rate(physics, speed_rad_s)
    history = SpeedHistory.constant(speed_rad_s)
    state = locked_state(physics, speed_rad_s, 0.0, *_LOCKED_RAD)
    grid = _moving(state, _grid(record_s), step, history, physics)
    omega = physics.natural_frequencies_rad_s[0]

    def angles(theta: Array) -> Array:
        now = _laid_over(physics, np.r_[theta[:2], theta[11:16]])
        true, late = theta[2:4] - theta[4:6], float(theta[6])
        start = locked_state(now, speed_rad_s, speed_rad_s * late, *true)
        start[[0, 1, 4, 5]] += theta[7:11]
        span = np.r_[late, late + grid[1:]]
        states = integrate(start, span, step, history.knots_s, history.coefficients, now.packed(), 1.0, 1.0)
        # a shift of the release moves the motion relative to the evaluated instants
        moved = states[1:, 2:4] - late * states[1:, 6:8]
        return (moved + theta[4:6]).T.ravel()

    theta = np.r_[0.0, 0.0, _LOCKED_RAD, np.zeros(12)]
    difference = np.r_[np.full(6, 1e-6), 1e-6, 1e-8, 1e-8, 1e-8 * omega, 1e-8 * omega, np.full(5, 1e-6)]
    quarter = 0.25 * sensors.encoder_step_rad  # uncertainty of the mean of quantised readings of a locked pendulum
    zero = sensors.encoder_zero_std_rad
    prior = np.r_[
        np.inf,
        np.inf,
        quarter,
        quarter,
        zero,
        zero,
        sensors.release_std_s,
        _LOCKED_STD_M,
        _LOCKED_STD_M,
        _LOCKED_STD_M * omega,
        _LOCKED_STD_M * omega,
        _PRIOR_STD,
    ]
    settings = {"speed_rpm": speed_rad_s * TO_RPM, "record_s": record_s}
    friction = _release_friction(physics, state, grid, step, history)
    model = _Model(angles, theta, difference, prior, friction, np.full(len(friction), True))
    return _experiment(test, "release", physics, sensors, model, settings, record_s, float(grid[-1]) + _INSTANT_S)


@dataclass(frozen=True)
class _Model:
    """Model of a test.

    Attributes:
        angles: maps θ to both pendulums' angles at the instants, rad.
        theta: nominal θ, shape (p,).
        difference: half-widths of the differences, shape (p,).
        prior: prior standard deviations, shape (p,).
        friction: derivatives of the angles by unknown friction, shape (n, k).
        used: whether the fit uses each angle, shape (n,).
    """

    angles: Callable[[Array], Array]
    theta: Array
    difference: Array
    prior: Array
    friction: Array
    used: NDArray[np.bool_]


def _experiment(
    test: str,
    method: Method,
    physics: RotorParameters,
    sensors: SensorProperties,
    model: _Model,
    settings: dict[str, float],
    record_s: float,
    used_s: float,
) -> Experiment:
    jacobian = np.hstack([derivatives(model.angles, model.theta, model.difference), model.friction])[model.used]
    prior = np.r_[model.prior, np.full(model.friction.shape[1], np.inf)]
    weight = np.sqrt(sensors.encoder_rate_Hz * _INSTANT_S) / sensors.encoder_noise_rad
    values = np.array([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad])
    own = covariance(jacobian * weight, prior, 2) * np.outer(values, values)
    shared = sensors.clock_error("angles", values * sensors.clock_rate_std("angles", record_s))
    remarks = ("the suspension is assumed to be known from ring-downs: k to 0.01 %, ζ and S_P to 0.1 %",)
    if used_s < record_s:
        remarks += (f"only the first {used_s:.2g} s, in which the pendulums move, contain information",)
    expected = Estimate(test, ("planned",), _NAMES, values, own, shared, "Fisher information")
    return Experiment(test, method, settings, record_s, expected, remarks=remarks)


def _spin_down_friction(physics: RotorParameters, time_s: Array, speed_rad_s: list[float]) -> Array:
    """Return the derivatives of both run-downs by a torque and a drag on A and on B, shape (n, 4).

    They are those on a fixed rotor; the disk's reaction changes them by a per cent.
    """
    n = len(time_s)
    out = np.zeros((2 * n, 4))
    for i, (p, speed) in enumerate(zip((physics.a, physics.b), speed_rad_s, strict=True)):
        rate = p.damping_Nms_per_rad / p.inertia_kg_m2
        out[i * n : (i + 1) * n, 2 * i : 2 * i + 2] = friction_columns(rate, speed, time_s)
    return out


def _moving(state: Array, grid: Array, step: float, history: SpeedHistory, physics: RotorParameters) -> Array:
    """Return the instants that the fit uses."""
    angle = integrate(state, grid, step, history.knots_s, history.coefficients, physics.packed(), 1.0, 1.0)[:, 2:4]
    return grid[grid <= fitted_until([(grid, each) for each in angle.T])]


def _release_friction(physics: RotorParameters, start: Array, grid: Array, step: float, history: SpeedHistory) -> Array:
    """Return the derivatives of a release's angles by the friction of A and B, shape (n, 4).

    They are those by a torque, per 1e-6 N m, and by friction with the contact force, per 1e-9 kg m².
    """
    packed, none = physics.packed(), np.zeros(2)
    knots, coefficients = history.knots_s, history.coefficients
    _, by = frictional_motion(start, 0.0, grid[1:], step, knots, coefficients, packed, none, True)
    unit = np.array([1e-6, 1e-6, 1e-9, 1e-9])
    return np.concatenate([by[:, 2, 15:], by[:, 3, 15:]]) * unit


def _grid(record_s: float) -> Array:
    return np.arange(0.0, record_s, _INSTANT_S)


def _angles(states: Array) -> Array:
    return states[1:, 2:4].T.ravel()


def _laid_over(physics: RotorParameters, log_change: Array) -> RotorParameters:
    """Return the parameters with the logarithms of c3, c4, k1, k2, ζ1, ζ2, S_P changed."""
    names = (*_NAMES, "k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
    nominal = physics.identified()
    return physics.with_values(
        **{n: nominal[n] * float(np.exp(change)) for n, change in zip(names, log_change, strict=True)}
    )
