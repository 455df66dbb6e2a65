"""Monte Carlo of predicted quantities: every source is drawn and the steady state follows by the nonlinear model.

A draw changes parameters, masses, lengths, run-out, bow and the axis angle. Dry friction enters linearly, as in the
prediction. The steady state of a draw is found from the nominal one by Newton steps on the half-revolution map with
the nominal inverse, y ← y + (1 − ∂H/∂y)⁻¹ (H(y) − y). A step integrates half a revolution and reduces the error by the
relative change of the map's slope. Source: JCGM 101, 7; docs/theory/uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.budget import PredictedBudgets, friction_label
from analysis.dry_friction import Sensors
from analysis.errors import NoStableState
from analysis.prediction import AXIS_ANGLE, fixed_point_inverse, half_turn, observed
from dynamics import RotorParameters
from dynamics.errors import DynamicsError
from rig_basics.arrays import Array
from rig_configs.known import with_number
from rig_configs.suspension_terms import TERMS, moved_term

_MAX_STEPS = 12
_MAX_LAST_STEP = 1e-9  # of the state at convergence: rad, m, rad/s, m/s
_SAME_STATE_RAD = 1.0  # an angle farther from the nominal one belongs to another steady state


@dataclass
class NonlinearModel:
    """Predicted quantities as a function of the errors of the budgets' sources, for `uncertainty.monte_carlo`.

    Attributes:
        of: budgets with their predictions.
        physics: parameters of the rig with the identified values; the bow is that of the budgets.
        progress: called with the completed share of the trials, 0 … 1.
        trials: number of trials, for `progress`.
    """

    of: PredictedBudgets
    physics: RotorParameters
    progress: Callable[[float], None] = field(default=lambda _: None)
    trials: int = 1
    _done: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        none: Array = np.zeros_like(self.of.slow_roll_sensitivities[0])
        self.physics = self._bent(self.physics, none)[0]
        self._inverses = {
            point: fixed_point_inverse(self.physics, found.speed_rad_s, found.state.start)
            for point, found in self.of.predictions.items()
        }

    def __call__(self, errors: Array) -> Array:
        """Return the quantities in the budgets' units, shape (rows, m).

        Raises:
            NoStableState: a draw has impossible parameters, or its steady state was not found from the nominal one.
        """
        values = np.empty((len(errors), len(self.of.quantities)))
        for row, error in enumerate(errors):
            values[row] = self._quantities(error)
            self._done += 1
            if self._done % 20 == 0:
                self.progress(min(1.0, self._done / self.trials))
        return values

    def _quantities(self, error: Array) -> Array:
        try:
            physics = self._drawn(error)
        except DynamicsError as fault:
            raise NoStableState(
                f"Monte Carlo: a draw has impossible parameters: {fault}; use the linear budget alone"
            ) from fault
        beta = self.of.axis_angle_rad
        if AXIS_ANGLE.text in self.of.first_columns:
            beta += float(error[self.of.first_columns[AXIS_ANGLE.text]])
        physics, run_out = self._bent(physics, error)
        seen = {point: self._at(point, physics, (beta, run_out), error) for point in self.of.predictions}
        return np.array([q.scale * seen[q.point][q.index] for q in self.of.quantities])

    def _drawn(self, error: Array) -> RotorParameters:
        """Return the parameters of one draw: numbers of the rig file first, as they condition the identified values."""
        found = self.physics.identified()
        shifts = self.of.parameter_sensitivities @ error
        physics = self.physics
        moved: dict[str, float] = {}
        for source in self.of.known.sources:
            if source.label.text in self.of.first_columns:
                share = float(error[self.of.first_columns[source.label.text]]) / source.std
                for number, step in source.effects.items():
                    moved[number] = moved.get(number, 0.0) + share * step
        for number, change in moved.items():
            if number in self.of.known.values and any(number in p.by_number for p in self.of.predictions.values()):
                physics = with_number(physics, number, self.of.known.values[number] + change)
        drawn = {n: found[n] + float(s) for n, s in zip(self.of.parameters, shifts, strict=True)}
        physics = physics.with_values(**drawn)
        for name, change in zip(TERMS, (self.of.term_sensitivities @ error).tolist(), strict=True):
            physics = moved_term(physics, name, change) if change else physics
        return physics

    def _bent(self, physics: RotorParameters, error: Array) -> tuple[RotorParameters, tuple[complex, complex]]:
        """Return the parameters with the bow of one draw, and its run-out in the complex amplitudes of x and y."""
        roll = self.of.slow_roll
        if roll is None:
            return physics, (0j, 0j)
        parts = (roll.values + self.of.slow_roll_sensitivities @ error).reshape(3, 2)
        x, y, bow = (complex(*part) for part in parts.tolist())
        return replace(physics, bow_x_m=bow.real, bow_y_m=bow.imag), (x, -1j * y)

    def _friction(self, point: str, error: Array) -> Array:
        """Return the change of the values at a point by dry friction, shape (5,)."""
        friction, at = self.of.predictions[point].friction, self.of.first_columns.get(friction_label(point), 0)
        return friction.shift + friction.slopes @ error[at : at + friction.slopes.shape[1]]

    def _at(self, point: str, physics: RotorParameters, sensors: Sensors, error: Array) -> Array:
        """Return the observed values at a point, shape (5,); angles within half a turn of the nominal ones."""
        nominal = self.of.predictions[point]
        speed, inverse = nominal.speed_rad_s, self._inverses[point]
        start: Array = np.array(nominal.state.start, dtype=np.float64)
        for _ in range(_MAX_STEPS):
            step = inverse @ (half_turn(physics, speed, start) - start)
            start = start + step
            if float(np.max(np.abs(step))) < _MAX_LAST_STEP:
                break
        else:
            raise NoStableState(
                f"Monte Carlo: point {point}: the steady state of a draw was not found from the nominal one in "
                f"{_MAX_STEPS} steps; use the linear budget alone"
            )
        values = observed(physics, speed, start, sensors) + self._friction(point, error)
        apart = (values[:2] - nominal.values[:2] + np.pi) % (2 * np.pi) - np.pi
        if float(np.max(np.abs(apart))) > _SAME_STATE_RAD:
            raise NoStableState(
                f"Monte Carlo: point {point}: a draw's angles are {np.degrees(np.max(np.abs(apart))):.0f}° from the "
                "nominal ones: another steady state; use the linear budget alone"
            )
        values[:2] = nominal.values[:2] + apart
        return values
