"""Properties of a steady motion, and the list of all at one speed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.model import ChosenModel
from rig_basics.tabular import Column, Tabular


@dataclass(frozen=True)
class SteadyState:
    """One steady motion.

    Attributes:
        type: "I" balanced, "II" pendulums opposed, "III" pendulums together; "one" with a single free pendulum,
            "none" with no free pendulum.
        theta_rad: mean θ3, θ4 over a revolution, in [0, 2π).
        start: state at ψ = 0, shape (8,).
        states: the motion at equally spaced phases of one revolution, shape (n, 8).
        amplitude_m: rms distance of the disk centre from the orbit's centre; for a circle its radius.
        x_m, y_m: complex order-1 amplitudes, x = Re(x_m e^{iψ}), y = Im(y_m e^{iψ}).
        multipliers: complex multipliers over one revolution, largest first; shape (8,), fewer with locked pendulums.
        error_estimate: bound on the error of the largest modulus.
        angle_error_rad, amplitude_error_m: bounds on the errors of theta_rad and amplitude_m.
        model: selected model with its reason.
        method: method of the multipliers with its reason.
        stick_half_width_rad: with dry friction, largest deviation from θ3, θ4 of a resting pendulum (0, 0 without).
        any_angle: whether the rotor has no preferred direction (no imbalance, no shift, no gravity). Both pendulums may
            then be turned together by any angle, and this is one of a circle of states.
    """

    type: str
    theta_rad: tuple[float, float]
    start: Array
    states: Array
    amplitude_m: float
    x_m: complex
    y_m: complex
    multipliers: Complex
    error_estimate: float
    angle_error_rad: float
    amplitude_error_m: float
    model: ChosenModel
    method: str
    stick_half_width_rad: tuple[float, float] = (0.0, 0.0)
    any_angle: bool = False

    @property
    def multiplier_max(self) -> float:
        """Largest modulus of the multipliers over one revolution."""
        return float(np.abs(self.multipliers[0]))

    @property
    def stability(self) -> str:
        """ "stable", "unstable", or "undecided" if the largest modulus is 1 within its error."""
        if self.multiplier_max + self.error_estimate < 1.0:
            return "stable"
        return "unstable" if self.multiplier_max - self.error_estimate > 1.0 else "undecided"

    @property
    def stable(self) -> bool:
        """Whether every multiplier lies inside the unit circle by more than the error estimate."""
        return self.stability == "stable"

    @property
    def draws(self) -> bool:
        """Whether the state is stable, or one of an attracting circle of states, along which it is neutral."""
        return self.stable or (self.any_angle and float(np.abs(self.multipliers[1])) + self.error_estimate < 1.0)


class SteadyStates(Tabular, list[SteadyState]):
    """Steady motions found at one speed, stable ones first.

    Attributes:
        unresolved: incomplete results, one line each: singular points of the mean torque near which the search for an
            orbit did not converge (the motion may or may not exist, because the imbalance may be too small to select
            an angle), and motions whose multipliers could not be computed to the accuracy.
    """

    def __init__(self, states: Iterable[SteadyState] = (), unresolved: Sequence[str] = ()) -> None:
        super().__init__(sorted(states, key=lambda s: (not s.stable, s.type)))
        self.unresolved: tuple[str, ...] = tuple(unresolved)

    @property
    def remarks(self) -> Sequence[str]:
        """The incomplete results."""
        return self.unresolved

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each state."""
        return {
            "type": [s.type for s in self],
            "theta3_rad": [s.theta_rad[0] for s in self],
            "theta4_rad": [s.theta_rad[1] for s in self],
            "amplitude_m": [s.amplitude_m for s in self],
            "multiplier_max": [s.multiplier_max for s in self],
            "stability": [s.stability for s in self],
        }
