# pyright: strict
"""Run-out taken off a point's complex order-1 amplitudes; how the differences at a point go with run-out and a bow."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig_configs.slow_roll import SlowRoll

if TYPE_CHECKING:
    from analysis.prediction import Prediction
    from analysis.steady_state import SteadyMeasurement

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SLOW_ROLL = ("run-out along", "run-out across", "bow along", "bow across")
"""What turns with the shaft at any speed, in the rotor's frame: along the imbalance, and a quarter turn ahead."""


def without_run_out(
    x: Complex, y: Complex, speed_rad_s: float, slow_roll: SlowRoll | None
) -> tuple[tuple[complex, complex], dict[str, Array]]:
    """Take run-out off the first of the complex amplitudes, in place.

    Args:
        x, y: complex amplitudes of orders 1, 2 …, m.
    Returns:
        What was taken off x and y, and by label how its errors shift (Re x, Im x, Re y, Im y), shape (4,).
    """
    if slow_roll is None:
        return (0j, 0j), {}
    own_x, own_y, slope = slow_roll.seen(speed_rad_s)
    x[0] -= own_x
    y[0] -= own_y
    shifts = {label: -slope @ shift for label, shift in slow_roll.shifts.items()}
    return (own_x, own_y), {label: shift for label, shift in shifts.items() if np.any(shift)}


def amplitude_slopes(x: complex, y: complex, radius: float) -> Array:
    """Derivatives of angles, both amplitudes and rms radius by angles and complex amplitudes, shape (5, 6)."""
    slope = np.zeros((5, 6))
    slope[0, 0] = slope[1, 1] = 1.0
    for row, j, first in ((2, 2, x), (3, 4, y)):
        slope[row, j : j + 2] = np.array([first.real, first.imag]) / max(abs(first), 1e-300)
        slope[4, j : j + 2] = np.array([first.real, first.imag]) / (2 * max(radius, 1e-300))
    return slope


def with_more_run_out(measured: SteadyMeasurement, run_out_m: complex) -> SteadyMeasurement:
    """The measurement as it were with more run-out r, common to both sensors, taken off: Re(r e^{iψ}), Im(r e^{iψ})."""
    x, y = measured.x_m - run_out_m, measured.y_m + 1j * run_out_m
    change = abs(x) ** 2 - abs(measured.x_m) ** 2 + abs(y) ** 2 - abs(measured.y_m) ** 2
    radius = math.sqrt(max(measured.amplitude_m.value**2 + 0.5 * change, 0.0))
    slope = amplitude_slopes(x, y, radius)
    return replace(
        measured, x_m=x, y_m=y, own=slope @ measured.to_come.covariance @ slope.T,
        amplitude_x_m=replace(measured.amplitude_x_m, value=abs(x)),
        amplitude_y_m=replace(measured.amplitude_y_m, value=abs(y)),
        amplitude_m=replace(measured.amplitude_m, value=radius),
        run_out_m=(measured.run_out_m[0] + run_out_m, measured.run_out_m[1] - 1j * run_out_m),
        run_out_shifts={label: slope[:, 2:] @ shift for label, shift in measured.run_out_errors.items()},
    )  # fmt: skip


def by_slow_roll(measured: SteadyMeasurement, predicted: Prediction) -> dict[str, Array]:
    """How the differences of a steady state go with run-out and bow that both sensors see alike, by SLOW_ROLL."""
    shown = np.zeros((4, 2))  # of Re x, Im x, Re y, Im y by r: x shows Re(r e^{iψ}), y Re(−i r e^{iψ})
    shown[:, 0], shown[:, 1] = (1.0, 0.0, 0.0, -1.0), (0.0, 1.0, 1.0, 0.0)
    angles, orbit = predicted.by_bow
    if predicted.at_rest:
        run_out, bow = np.vstack([np.zeros((2, 2)), shown]), np.vstack([angles[:2], orbit])
    else:
        along = np.zeros((2, 4))
        for row, z in enumerate((measured.x_m, measured.y_m)):
            along[row, 2 * row : 2 * row + 2] = np.array([z.real, z.imag]) / max(abs(z), 1e-300)
        run_out, bow = np.vstack([np.zeros((2, 2)), along @ shown]), angles[:4]
    return dict(zip(SLOW_ROLL, np.hstack([run_out, bow]).T, strict=True))
