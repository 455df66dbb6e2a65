"""Dry friction of the pendulums as identified, and the uncertainty of a steady state that results from it.

With friction a pendulum rests anywhere in a band about its frictionless angle. The prediction is the frictionless
angle. The band is a type B uncertainty of its own with an even distribution, independent at each point, because the
resting places of two points have nothing in common. Pendulums that oscillate too strongly to be held are shifted by the
mean torque of the friction; the prediction contains this shift. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import RotorParameters, SteadyState
from dynamics.steady.held_band import HeldBand, held_band
from dynamics.steady.sliding_shift import Motion, sliding_shift
from rig_basics.arrays import Array
from rig_configs import IdentifiedParameters
from rig_configs.drag import with_undecided_spread
from rig_configs.known import KEPT_FRICTION

FIRST_ORDER = 0.1
"""Relative standard uncertainty of a shift that is calculated to first order in the friction."""


@dataclass(frozen=True)
class DryFriction:
    """Torque M + F ω² against the motion of a pendulum.

    Attributes:
        values: M_A, M_B (N m), F_A, F_B (kg m²), shape (4,).
        covariance: shape (4, 4).
    """

    values: Array
    covariance: Array

    @classmethod
    def of(cls, identified: IdentifiedParameters) -> DryFriction | None:
        """Return the friction stored in parameters.toml; None if no test identified any."""
        kept: Mapping[str, Any] | None = with_undecided_spread(identified.provenance).get("friction")
        if kept:
            values = np.array([float(kept["values"][n]) for n in KEPT_FRICTION])
            return cls(values, np.array(kept["covariance"], np.float64)) if np.any(values > 0) else None
        tests: list[Mapping[str, Any]] = identified.provenance.get("tests", [])
        found = [test for test in tests if test.get("friction")]
        if not found:
            return None
        values, std = found[-1]["friction"], found[-1].get("friction_std", {})
        return cls(
            np.array([float(values.get(n, 0.0)) for n in KEPT_FRICTION]),
            np.diag([float(std.get(n, 0.0)) ** 2 for n in KEPT_FRICTION]),
        )

    def torque_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Return M + F ω² of A and B and its standard uncertainty, N m, shape (2,) each."""
        design = np.hstack([np.eye(2), speed_rad_s**2 * np.eye(2)])
        return design @ self.values, np.sqrt(np.diag(design @ self.covariance @ design.T))

    def band(self, physics: RotorParameters, speed_rad_s: float, theta_rad: tuple[float, float]) -> HeldBand:
        """Return the band in which the pendulums may rest; the torque's uncertainty is added as root mean square."""
        value, std = self.torque_at(speed_rad_s)
        return held_band(physics, speed_rad_s, theta_rad, np.hypot(np.maximum(value, 0.0), std))

    def shift(
        self, physics: RotorParameters, speed_rad_s: float, start: Array, motion: Motion
    ) -> tuple[NDArray[np.complex128], float]:
        """Return the shift of an oscillating state: mean θ3, θ4, order-1 x and y; and its relative uncertainty.

        Args:
            start: state of the frictionless motion at ψ = 0, shape (8,).
            motion: function that integrates the motion.
        """
        value, std = self.torque_at(speed_rad_s)
        torque = np.maximum(value, 0.0)
        share = float(np.max(std) / np.max(torque)) if np.max(torque) > 0 else 0.0
        return sliding_shift(physics, speed_rad_s, start, motion, torque), math.hypot(share, FIRST_ORDER)


@dataclass(frozen=True)
class LeftOpen:
    """Contribution of dry friction to a prediction: θ3, θ4, order-1 amplitudes in sensor axes, rms radius.

    Attributes:
        held: band about the state's angles in which friction may hold the pendulums; None if no friction is known.
        shift: shift of the values, shape (5,).
        slopes: derivatives of the values by the uncertain inputs, shape (5, k): both resting angles of held pendulums
            (rad), or the relative error of the shift, or no input.
        covariance: covariance of these inputs, shape (k, k).
    """

    held: HeldBand | None = None
    shift: Array = field(default_factory=lambda: np.zeros(5))
    slopes: Array = field(default_factory=lambda: np.zeros((5, 0)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def of_values(self) -> Array:
        """Covariance of the values, shape (5, 5)."""
        return self.slopes @ self.covariance @ self.slopes.T


Sensors = tuple[float, tuple[complex, complex]]
"""Angle from the stiffness to the sensor x axis, rad, and run-out in the complex amplitudes of x and y, m."""


def left_open(
    friction: DryFriction | None,
    physics: RotorParameters,
    speed: float,
    state: SteadyState,
    motion: Motion,
    sensors: Sensors,
) -> LeftOpen:
    """Return the contribution of dry friction to a steady state.

    Args:
        friction: identified friction; None if none is known.
        state: frictionless steady state.
        motion: function that integrates the motion.
    """
    if friction is None:
        return LeftOpen()
    held = friction.band(physics, speed, (float(state.theta_rad[0]), float(state.theta_rad[1])))
    orbit = np.array([state.x_m, -1j * state.y_m])
    if np.any(held.half_width_rad > 0):
        return LeftOpen(held, slopes=seen_slopes(held, orbit, sensors), covariance=held.covariance)
    moved, share = friction.shift(physics, speed, np.asarray(state.start, np.float64), motion)
    shift = seen_shift(moved, orbit, sensors)
    return LeftOpen(held, shift, shift[:, None], np.array([[share**2]]))


def _turn(beta_rad: float) -> Array:
    """Return the rotation from stiffness axes to sensor axes."""
    return np.array([[math.cos(beta_rad), math.sin(beta_rad)], [-math.sin(beta_rad), math.cos(beta_rad)]])


def seen_shift(shift: NDArray[np.complex128], orbit: NDArray[np.complex128], sensors: Sensors) -> Array:
    """Convert a shift of mean angles and orbit into θ3, θ4, amplitudes in sensor axes and rms radius, shape (5,).

    Args:
        shift: shift of θ3, θ4 (rad), X and Y in stiffness axes (m), shape (4,).
        orbit: X, Y before the shift, m.
    """
    turn, run_out = _turn(sensors[0]), np.array(sensors[1])
    before, after = np.abs(turn @ orbit + run_out), np.abs(turn @ (orbit + shift[2:]) + run_out)
    radius = math.sqrt(0.5) * (float(np.linalg.norm(after)) - float(np.linalg.norm(before)))
    return np.r_[np.real(shift[:2]), after - before, radius]


def seen_slopes(band: HeldBand, orbit: NDArray[np.complex128], sensors: Sensors) -> Array:
    """Return the derivatives of θ3, θ4, amplitudes in sensor axes and rms radius by the resting angles, shape (5, 2).

    Args:
        orbit: X, Y of the frictionless state in stiffness axes, m. The derivative of an amplitude of 0 is set to 0.
    """
    turn = _turn(sensors[0])
    seen, by = turn @ orbit + np.array(sensors[1]), turn @ band.orbit_slopes
    size, out = np.abs(seen), np.zeros((5, 2))
    out[:2] = np.eye(2)
    along = np.real(np.conj(seen)[:, None] * by)
    out[2:4] = along / np.maximum(size, 1e-300)[:, None]
    out[4] = along.sum(axis=0) / (2 * max(math.sqrt(0.5 * float(size @ size)), 1e-300))
    return out
