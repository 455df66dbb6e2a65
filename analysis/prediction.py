"""Stable steady state of the model at a measured speed, with the covariance of the identified parameters.

A steady state y is a fixed point of the half-revolution map, y = H(y, p). Differentiation yields
dy/dp = (1 − ∂H/∂y)⁻¹ ∂H/∂p. One converged state and a few integrations over half a revolution therefore replace a new
search per parameter. The compared quantities (angles, order-1 amplitudes in sensor axes, rms radius) are functions of y
and p and are differentiated along that direction. Besides the identified parameters p contains the masses and lengths
of the rig file: an error in one of them changes identified values and prediction together, and counts once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.dry_friction import DryFriction, LeftOpen, Sensors, left_open
from analysis.errors import NoStableState
from analysis.run_out import by_shown_run_out, shown_run_out, with_run_out
from analysis.stable_states import stable_states
from analysis.term_errors import TERM_STEPS, term_errors, uncertain_terms
from dynamics import RotorParameters, SpeedHistory, SteadyState
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import fastest_rate, integrate
from dynamics.steady.held_band import HeldBand
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_basics.units import TO_RPM
from rig_configs import IdentifiedParameters, Rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import KnownNumbers, physical_numbers, with_number
from rig_configs.suspension_terms import TERMS, moved_term

Start = Array

AXIS_ANGLE = ErrorLabel("axis angle")
"""Label of the axis angle's error, which all points share."""
_SPEED = "speed"
BOW = ("bow_x_m", "bow_y_m")
_BOW_STEP_M = 1e-7
_AT_REST_M = 1e-9  # orbit size below which the disk is at rest
QUANTITIES = ("theta3", "theta4", "amplitude_x", "amplitude_y", "amplitude")
QUANTITIES_SI = ("theta3_rad", "theta4_rad", "amplitude_x_m", "amplitude_y_m", "amplitude_m")
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
_SCALE = np.array([1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3])  # difference steps of the state


@dataclass(frozen=True)
class Prediction(Tabular):
    """One stable steady state as the sensors measure it.

    Attributes:
        state: steady state of the model (stiffness axes).
        speed_rad_s: speed of the state.
        values: θ3, θ4 (rad, [0, 2π)), order-1 amplitudes of x and y in sensor axes (m), rms radius (m); order of
            QUANTITIES.
        covariance: covariance of `values` from parameters, known numbers, axis angle and speed, shape (5, 5).
        by_parameter: derivatives of `values` by the identified parameters, in their order, shape (5, n).
        by_number: number of the rig file → derivative of `values` by it at fixed parameters, shape (5,).
        own: part of `covariance` that no other point shares: speed and friction, shape (5, 5).
        shared: label → shift of `values`, shape (5,), per standard deviation of an error shared with other quantities:
            gains, known numbers, the axis angle.
        numerical: estimated error of the integration in `values`, shape (5,).
        by_bow: derivatives of `values` by real and imaginary part of a bow, shape (5, 2), and those of the real and
            imaginary parts of the complex order-1 amplitudes of x and y, shape (4, 2).
        orbit: complex order-1 amplitudes of x and y with run-out, x = Re(x e^{iψ}), y alike.
        by_run_out_and_bow: derivatives of `values` by run-out and bow, in the order of SlowRoll.values, shape (5, 6).
        friction: contribution of dry friction, part of `own`.
        by_term: identified or likely term of the suspension → derivative of `values` by it, shape (5,).
    """

    state: SteadyState
    speed_rad_s: float
    values: Array
    covariance: Array
    by_parameter: Array
    by_number: Mapping[str, Array]
    own: Array
    shared: Mapping[ErrorLabel, Array]
    numerical: Array
    by_bow: tuple[Array, Array]
    orbit: tuple[complex, complex]
    by_run_out_and_bow: Array
    friction: LeftOpen = field(default_factory=LeftOpen)
    by_term: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @property
    def heading(self) -> str:
        """State and speed."""
        return f"Prediction: state {self.state.type} at {self.speed_rad_s * TO_RPM:.2f} rpm"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity."""
        return {"quantity": QUANTITIES_SI, "value": self.values, "std": self.std}

    @property
    def held(self) -> HeldBand | None:
        """Band about the state's angles in which dry friction may hold the pendulums; None without known friction."""
        return self.friction.held

    @property
    def at_rest(self) -> bool:
        """Whether the sensors show no vibration: a balanced state of a straight shaft without run-out."""
        return self.state.type == "I" and abs(self.orbit[0]) + abs(self.orbit[1]) < _AT_REST_M

    @property
    def std(self) -> Array:
        """Standard deviations of `values`, shape (5,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def predict_point(
    rig: Rig,
    identified: IdentifiedParameters,
    speed_rad_s: float,
    axis_angle_deg: tuple[float, float] | None = None,
    *,
    speed_std_rad_s: float = 0.0,
    near_rad: Sequence[float] | None = None,
) -> Prediction:
    """Predict the stable steady state at a speed, with its uncertainty from the identified parameters.

    Args:
        rig: rig file with masses and lengths; its suspension, damping and S_P are replaced by the identified ones.
        identified: identified values with covariance, SI.
        speed_rad_s, speed_std_rad_s: running speed and its standard uncertainty.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty; None for
            the identified angle, or the mounting angle of the rig file if no test identified it.
        near_rad: measured θ3, θ4; the nearest of several stable states (mirror images) is returned.
    Raises:
        NoStableState: no stable steady state exists, or the search failed.
    """
    physics, state = _stable_state(rig, identified, speed_rad_s, near_rad)
    beta, beta_std = (math.radians(v) for v in known_axis_angle(identified, rig, axis_angle_deg))
    run_out = shown_run_out(identified.slow_roll)
    terms = uncertain_terms(identified)
    names = [*identified.values, *terms]
    shown, slopes, numerical = _slopes(physics, names, state, speed_rad_s, (beta, run_out))
    values = shown[:5]
    by_parameter = np.stack([slopes.pop(name) for name in identified.values] or [np.empty((5, 0))], axis=-1)
    by_term = {name: slopes.pop(name) for name in terms}
    bow = np.stack([slopes.pop(name) for name in BOW], axis=-1)
    by_run_out_and_bow = np.hstack([by_shown_run_out(shown), bow[:5]])
    by_speed, by_angle = slopes.pop(_SPEED), slopes.pop(AXIS_ANGLE.text)
    friction = _friction(identified, physics, speed_rad_s, state, (beta, run_out))
    values = values + friction.shift
    own = np.outer(by_speed, by_speed) * speed_std_rad_s**2 + friction.of_values
    shared = {AXIS_ANGLE: by_angle * beta_std, **_shared(rig.known, identified, by_parameter, slopes)}
    _add_roll_and_term_errors(shared, rig, identified, by_run_out_and_bow, by_term)
    covariance = own + by_parameter @ identified.own_covariance @ by_parameter.T
    covariance = covariance + np.sum([np.outer(shift, shift) for shift in shared.values()], axis=0)
    return Prediction(
        state,
        speed_rad_s,
        values,
        covariance,
        by_parameter,
        slopes,
        own,
        shared,
        numerical,
        (bow[:5], bow[5:]),
        (complex(*shown[5:7]), complex(*shown[7:])),
        by_run_out_and_bow,
        friction,
        by_term,
    )


def _stable_state(
    rig: Rig, identified: IdentifiedParameters, speed_rad_s: float, near_rad: Sequence[float] | None
) -> tuple[RotorParameters, SteadyState]:
    """Return the identified rig and its stable steady state; arguments and errors as for predict_point."""
    try:
        physics = identified.applied_to(rig.physics)
        states = stable_states(physics, speed_rad_s)
    except (DynamicsError, np.linalg.LinAlgError) as error:
        raise NoStableState(f"the search for steady states failed: {error}") from error
    if not states:
        raise NoStableState(f"the model has no stable steady state at {speed_rad_s * TO_RPM:.1f} rpm")
    return physics, states[0] if near_rad is None else min(states, key=lambda s: _distance(s, near_rad))


def _friction(
    identified: IdentifiedParameters, physics: RotorParameters, speed: float, state: SteadyState, sensors: Sensors
) -> LeftOpen:
    """Return the contribution of dry friction to a steady state."""

    def motion(start: Start, times: Array) -> Array:
        return _motion(physics, speed, start, times)

    return left_open(DryFriction.of(identified), physics, speed, state, motion, sensors)


def _add_roll_and_term_errors(
    shared: dict[ErrorLabel, Array],
    rig: Rig,
    identified: IdentifiedParameters,
    by_run_out_and_bow: Array,
    by_term: Mapping[str, Array],
) -> None:
    """Add the errors of run-out, bow and suspension terms to the shifts by label, shape (5,) each."""
    if identified.slow_roll is not None:
        for label, error in identified.slow_roll.errors(rig.roles.gain_stds, rig.known).items():
            shared[label] = shared.get(label, np.zeros(5)) + by_run_out_and_bow @ error
    for label, shift in term_errors(rig, identified, by_term).items():
        shared[label] = shared.get(label, np.zeros(5)) + shift


def _shared(
    known: KnownNumbers, identified: IdentifiedParameters, by_parameter: Array, by_number: Mapping[str, Array]
) -> dict[ErrorLabel, Array]:
    """Return label → shift of the values per standard deviation of a shared error, shape (5,) each."""
    shared = {label: by_parameter @ shift for label, shift in identified.shared_with(known).items()}
    for source in known.sources:
        parts = [by_number[name] * step for name, step in source.effects.items() if name in by_number]
        if parts or source.label in shared:
            shared[source.label] = np.sum([shared.get(source.label, np.zeros(5)), *parts], axis=0)
    return shared


def known_axis_angle(
    identified: IdentifiedParameters, rig: Rig, given_deg: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Return angle and standard uncertainty in degrees: as given (not NaN), else as identified, else as mounted."""
    for angle in (given_deg, identified.axis_angle_deg):
        if angle is not None and all(map(math.isfinite, angle)):
            return angle
    return rig.roles.mounted_deg


def _distance(state: SteadyState, near: Sequence[float]) -> float:
    return float(np.sum(np.abs(np.exp(1j * np.array(state.theta_rad)) - np.exp(1j * np.asarray(near)))))


def _motion(physics: RotorParameters, speed: float, start: Start, times: Array, finer: float = 1.0) -> Array:
    """Integrate from a start at ψ = 0 at constant speed with free pendulums; `finer` below 1 shortens the steps."""
    history = SpeedHistory.constant(speed)
    step = finer * 0.03 / fastest_rate(physics, speed)
    packed = physics.packed()
    return integrate(start, times, step, history.knots_s, history.coefficients, packed, 1.0, 1.0)


def half_turn(physics: RotorParameters, speed: float, start: Start, finer: float = 1.0) -> Array:
    """Evaluate the map H whose fixed points are the steady states."""
    return _TURN * _motion(physics, speed, start, np.array([0.0, np.pi / speed]), finer)[-1]


def fixed_point_inverse(physics: RotorParameters, speed: float, start: Start) -> Array:
    """Return (1 − ∂H/∂y)⁻¹ at a steady state, shape (8, 8): change of the state per change of the map at its start."""
    slope = np.empty((8, 8))
    for j, h in enumerate(_SCALE):
        up, down = start.copy(), start.copy()
        up[j] += h
        down[j] -= h
        slope[:, j] = (half_turn(physics, speed, up) - half_turn(physics, speed, down)) / (2 * h)
    return np.asarray(np.linalg.inv(np.eye(8) - slope), dtype=np.float64)


def observed(physics: RotorParameters, speed: float, start: Start, sensors: Sensors) -> Array:
    """Return θ3, θ4, order-1 amplitudes in sensor axes and rms radius with run-out, mean of one revolution, (5,)."""
    return _shown(physics, speed, start, sensors)[:5]


def _shown(physics: RotorParameters, speed: float, start: Start, sensors: Sensors, finer: float = 1.0) -> Array:
    """Return the observed values and (Re, Im) of both complex order-1 amplitudes, shape (9,)."""
    n = 64
    times = np.linspace(0, 2 * np.pi / speed, n + 1)
    states = _motion(physics, speed, start, times, finer)[:-1]
    turn = np.exp(-1j * speed * times[:-1])
    x, y = states[:, 0], states[:, 1]
    x_sensor, y_sensor = _rotated(complex(2 * np.mean(x * turn)), complex(2 * np.mean(y * turn)), sensors[0])
    radius = math.sqrt(float(np.mean(x * x + y * y)))
    return with_run_out(states[:, 2:4].mean(axis=0), x_sensor, y_sensor, radius, sensors[1])


def _rotated(x: complex, y: complex, beta: float) -> tuple[complex, complex]:
    """Rotate from stiffness axes to sensor axes."""
    c, s = math.cos(beta), math.sin(beta)
    return x * c + y * s, -x * s + y * c


def _slopes(
    physics: RotorParameters, names: Sequence[str], state: SteadyState, speed: float, sensors: Sensors
) -> tuple[Array, dict[str, Array], Array]:
    """Return the observed values (9,), their derivatives (5,) by all inputs, and their numerical error (5,).

    Inputs are parameters, known numbers, speed, axis angle and bow. Derivatives by a bow have shape (9,).
    The error is the change of values and fixed point when the integration step is halved.
    """
    start = state.start
    inverse = fixed_point_inverse(physics, speed, start)
    found, known = physics.identified(), physical_numbers(physics)
    slopes: dict[str, Array] = {}
    same, (beta, run_out) = (sensors, sensors), sensors
    for name in names:
        if name in TERMS:
            h = TERM_STEPS[name]
            pair = [moved_term(physics, name, sign * h) for sign in (1, -1)]
        else:
            h = 1e-4 * abs(found[name]) or 1e-9
            pair = [physics.with_values(**{name: found[name] + sign * h}) for sign in (1, -1)]
        slopes[name] = _along(pair, (speed, speed), same, start, inverse, h)[:5]
    for name, value in known.items():
        if value:
            h = 1e-4 * value
            pair = [with_number(physics, name, value + sign * h) for sign in (1, -1)]
            slopes[name] = _along(pair, (speed, speed), same, start, inverse, h)[:5]
    for name in BOW:
        h = _BOW_STEP_M
        pair = [replace(physics, **{name: getattr(physics, name) + sign * h}) for sign in (1, -1)]
        slopes[name] = _along(pair, (speed, speed), same, start, inverse, h)
    h = 1e-5 * speed
    slopes[_SPEED] = _along([physics, physics], (speed + h, speed - h), same, start, inverse, h)[:5]
    h = 1e-4
    turned = ((beta + h, run_out), (beta - h, run_out))
    slopes[AXIS_ANGLE.text] = _along([physics, physics], (speed, speed), turned, start, inverse, h)[:5]
    values = _shown(physics, speed, start, sensors)
    finer = start + inverse @ (half_turn(physics, speed, start, 0.5) - half_turn(physics, speed, start))
    numerical = np.abs(_shown(physics, speed, finer, sensors, 0.5) - values)[:5]
    values[:2] %= 2 * np.pi
    return values, slopes, numerical


def _along(
    pair: Sequence[RotorParameters],
    speeds: tuple[float, float],
    sensors: tuple[Sensors, Sensors],
    start: Start,
    inverse: Array,
    h: float,
) -> Array:
    """Return the derivative of the observed values by a number, the steady state moving with it, shape (9,)."""
    up, down = (half_turn(p, w, start) for p, w in zip(pair, speeds, strict=True))
    moved = inverse @ (up - down) / 2  # of the state, for +h
    seen = [_shown(p, w, start + sign * moved, s) for p, w, s, sign in zip(pair, speeds, sensors, (1, -1), strict=True)]
    return (seen[0] - seen[1]) / (2 * h)
