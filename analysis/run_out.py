"""Run-out in the prediction for the sensors, and change of the differences at a point with run-out and a bow.

The sensors measure |X + r| for a motion X and run-out r. Adding r to the prediction needs no phase of the measured
amplitudes. Subtracting r from the measurement would need it, and that phase contains the unknown lag between laser and
rotor phase.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rig_basics.arrays import Array
from rig_configs.slow_roll import SlowRoll

if TYPE_CHECKING:
    from analysis.prediction import Prediction
    from analysis.steady_state import SteadyMeasurement


SLOW_ROLL = ("run-out along", "run-out across", "bow along", "bow across")
"""Vectors that turn with the shaft at any speed, in the rotor's frame: along the imbalance, and 90° ahead."""
_ALIKE = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [-1.0, 0.0]])
"""(Re, Im) of x and y by (Re, Im) of a run-out r common to both: Re(r e^{iψ}) and Re(−i r e^{iψ})."""


def shown_run_out(slow_roll: SlowRoll | None) -> tuple[complex, complex]:
    """Return the run-out in the complex order-1 amplitudes of x and y, x = Re(X e^{iψ}) in either sensor."""
    return (0j, 0j) if slow_roll is None else (slow_roll.run_out_x_m, -1j * slow_roll.run_out_y_m)


def with_run_out(angles: Array, x: complex, y: complex, radius: float, run_out: tuple[complex, complex]) -> Array:
    """Return predicted values: θ3, θ4, both amplitudes, rms radius, (Re, Im) of both complex amplitudes, shape (9,).

    Args:
        x, y, radius: amplitudes and rms radius of the motion without run-out.
    """
    shown_x, shown_y = x + run_out[0], y + run_out[1]
    more = abs(shown_x) ** 2 - abs(x) ** 2 + abs(shown_y) ** 2 - abs(y) ** 2
    whole = math.sqrt(max(radius**2 + 0.5 * more, 0.0))
    orbit = (shown_x.real, shown_x.imag, shown_y.real, shown_y.imag)
    return np.array([*angles, abs(shown_x), abs(shown_y), whole, *orbit])


def by_orbit(values: Array) -> Array:
    """Return derivatives of θ3, θ4, both amplitudes and rms radius by (Re x, Im x, Re y, Im y), shape (5, 4).

    Args:
        values: result of with_run_out.
    """
    slope = np.zeros((5, 4))
    for row, at in ((2, 0), (3, 2)):
        pair = values[5 + at : 7 + at]
        slope[row, at : at + 2] = pair / max(float(values[row]), 1e-300)
        slope[4, at : at + 2] = pair / (2 * max(float(values[4]), 1e-300))
    return slope


def by_shown_run_out(shown: Array) -> Array:
    """Return derivatives of θ3, θ4, both amplitudes and rms radius by (Re r_x, Im r_x, Re r_y, Im r_y), shape (5, 4).

    Args:
        shown: result of with_run_out.
    """
    turn = np.zeros((4, 4))
    turn[:2, :2], turn[2:, 2:] = np.eye(2), [[0.0, 1.0], [-1.0, 0.0]]  # y shows −i r_y
    return by_orbit(shown) @ turn


def by_slow_roll(measured: SteadyMeasurement, predicted: Prediction) -> dict[str, Array]:
    """Return the change of a point's differences per metre of run-out and bow common to both sensors, by SLOW_ROLL."""
    angles, orbit = predicted.by_bow
    if predicted.at_rest:
        run_out, bow = np.vstack([np.zeros((2, 2)), _ALIKE]), np.vstack([angles[:2], orbit])
    else:
        x, y = predicted.orbit
        values = np.array([0.0, 0.0, abs(x), abs(y), 1.0, x.real, x.imag, y.real, y.imag])
        run_out, bow = by_orbit(values)[:4] @ _ALIKE, angles[:4]
    return dict(zip(SLOW_ROLL, np.hstack([run_out, bow]).T, strict=True))
