"""The model of a rig as its sensors see it, for comparison with measurements."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.prediction import known_axis_angle
from analysis.run_out import shown_run_out
from analysis.stable_states import stable_states
from dynamics import RotorParameters, SteadyState, locked_orbit
from dynamics.errors import DynamicsError
from rig_basics.arrays import Array, Complex
from rig_configs import IdentifiedParameters, Rig

_log = logging.getLogger(__name__)

LOCKED_RAD = (0.0, math.pi)
"""Angles at which the locks hold the pendulums."""


@dataclass(frozen=True)
class RigModel:
    """A rig's parameters with the geometry and run-out of its sensors.

    Attributes:
        physics: parameters of the rotor.
        axis_angle_rad: angle from the stiffness x axis to the sensor x axis.
        run_out_m: run-out in the complex order-1 amplitudes of x and y, x = Re(X e^{iψ}), y alike.
        name: origin of the parameters, for legends.
        rig: rig file.
        identified: parameters applied to it; None without.
    """

    physics: RotorParameters
    axis_angle_rad: float
    run_out_m: tuple[complex, complex]
    name: str
    rig: Rig
    identified: IdentifiedParameters | None = None

    @classmethod
    def of(cls, rig: Rig, identified: IdentifiedParameters | None = None, name: str = "") -> RigModel:
        """Return the model of a rig file, with identified parameters in place of the file's if they are given."""
        known = identified or IdentifiedParameters({}, np.zeros((0, 0)))
        angle = math.radians(known_axis_angle(known, rig)[0])
        source = name or ("rig file" if identified is None else "identified parameters")
        return cls(known.applied_to(rig.physics), angle, shown_run_out(known.slow_roll), source, rig, identified)

    @property
    def speeds_rad_s(self) -> tuple[float, float]:
        """Both natural frequencies of the column, rad/s."""
        return self.physics.natural_frequencies_rad_s

    def locked(self, speed_rad_s: Array, theta_rad: tuple[float, float] = LOCKED_RAD) -> tuple[Complex, Complex]:
        """Return steady order-1 amplitudes of x and y with locked pendulums and run-out; NaN where no solution exists.

        Args:
            speed_rad_s: speeds, shape (n,).
            theta_rad: angles of the locked pendulums.
        Returns:
            X and Y in sensor axes, shapes (n,), m: x = Re(X e^{iψ}), y = Re(Y e^{iψ}).
        """
        found = np.full((len(speed_rad_s), 2), np.nan + 0j)
        for i, speed in enumerate(map(float, speed_rad_s)):
            try:
                x, y = locked_orbit(self.physics, speed, *theta_rad)
            except DynamicsError:  # usual: an undamped resonance; the speed stays NaN
                continue
            found[i] = self.shown_orders(x, -1j * y)
        return found[:, 0], found[:, 1]

    def shown_orders(self, x: complex, y: complex) -> tuple[complex, complex]:
        """Convert complex order-1 amplitudes along the stiffness axes to those of the sensors, both as Re(… e^{iψ})."""
        c, s = math.cos(self.axis_angle_rad), math.sin(self.axis_angle_rad)
        return x * c + y * s + self.run_out_m[0], -x * s + y * c + self.run_out_m[1]

    def shown(self, x_m: Array, y_m: Array, phase_rad: Array) -> tuple[Array, Array]:
        """Convert displacements along the stiffness axes to those of the sensors at the given phases; shapes (n,)."""
        c, s = math.cos(self.axis_angle_rad), math.sin(self.axis_angle_rad)
        turn = np.exp(1j * phase_rad)
        x, y = ((run_out * turn).real for run_out in self.run_out_m)
        return x_m * c + y_m * s + x, -x_m * s + y_m * c + y

    def steady_state(self, speed_rad_s: float, near_rad: Sequence[float] | None = None) -> SteadyState | None:
        """Return the stable steady state at a speed, the nearest to measured angles; None if it does not exist."""
        try:
            states = stable_states(self.physics, speed_rad_s)
        except (DynamicsError, np.linalg.LinAlgError) as error:
            _log.info("no steady state of the model at %.6g rad/s: %s", speed_rad_s, error)
            return None
        if not states:
            return None
        if near_rad is None:
            return states[0]
        near = np.exp(1j * np.asarray(near_rad, np.float64))
        return min(states, key=lambda s: float(np.sum(np.abs(np.exp(1j * np.array(s.theta_rad)) - near))))
