"""Periodic orbits at constant speed by harmonic balance in the rotor's phase.

A steady motion is periodic with the rotor. Without gravity, x and y change sign after half a revolution and the angles
repeat: x, y contain odd orders of the rotor's phase, θ3, θ4 even ones. The unknowns are the Fourier coefficients
that N equally spaced phases of half a revolution resolve (2N of a whole one with gravity). The forces are evaluated at
those phases and transformed back. Newton's method solves the balance, with the exact Jacobian of the compiled kernel.
The method has neither a time step nor a stability limit: the cost is independent of damping and speed. The error
decreases faster than any power of N. N is doubled until the orbit does not change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.kernels import BX, BY, FA, FB, GRAVITY
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.harmonic_balance import Grid, solve_balance

_MIN_PHASES, _MAX_PHASES = 8, 256  # phases per half revolution
_MIN_BOW_RATIO = 1e-3  # scale of x, y relative to a bow


@dataclass(frozen=True)
class Orbit:
    """One periodic motion.

    Attributes:
        states: shape (n, 8), at n equally spaced phases ψ_j = 2πj/n of a whole revolution.
        coarse_states: the orbit from half as many phases, shape (n/2, 8).
        angle_error_rad, position_error_m: bounds on the error of the angles and of x, y, from doubling the number of
            phases and from Newton's last step.
    """

    states: Array
    coarse_states: Array
    angle_error_rad: float
    position_error_m: float


def coarse_orbit(
    parameters: RotorParameters,
    speed_rad_s: float,
    guess: Array,
    released: tuple[bool, bool] = (True, True),
) -> Array | None:
    """The orbit at the lowest resolution, sufficient to distinguish it from others.

    Args:
        guess: as for periodic_orbit.
    Returns:
        States over a whole revolution, shape (16, 8), or None if Newton's method does not converge.
    """
    packed, free = _frictionless(parameters, released)
    grid = Grid.of(_MIN_PHASES, bool(packed[GRAVITY] == 0.0))
    solved = solve_balance(grid, speed_rad_s, packed, free, grid.coefficients(guess), _least_size(packed))
    return None if solved is None else grid.whole(solved[0])


def _frictionless(parameters: RotorParameters, released: tuple[bool, bool]) -> tuple[Array, tuple[bool, bool]]:
    """Packed parameters without dry friction, and which pendulums exist and are free."""
    packed = parameters.packed()
    packed[FA] = packed[FB] = 0.0
    return packed, (released[0] and parameters.a.present, released[1] and parameters.b.present)


def periodic_orbit(
    parameters: RotorParameters,
    speed_rad_s: float,
    guess: Array,
    accuracy: float,
    released: tuple[bool, bool] = (True, True),
) -> Orbit | None:
    """The periodic orbit found by Newton's method from a guess.

    Dry friction is neglected: with it an orbit becomes a band of rest positions (see dynamics.steady.steady_motions).

    Args:
        guess: positions x, y (m), θ3, θ4 (rad) at equally spaced phases of a whole revolution, shape (n, 4).
        accuracy: permitted error of the angles (rad), and of x, y relative to the orbit's size.
    Returns:
        The orbit, or None if the iteration does not converge.
    """
    packed, free = _frictionless(parameters, released)
    positions, before, half = guess, None, _MIN_PHASES
    while half <= _MAX_PHASES:
        grid = Grid.of(half, bool(packed[GRAVITY] == 0.0))
        solved = solve_balance(grid, speed_rad_s, packed, free, grid.coefficients(positions), _least_size(packed))
        if solved is None:
            return None
        whole = grid.whole(solved[0])
        if before is not None:
            size = max(float(np.max(np.abs(whole[:, :2]))), _least_size(packed))
            change = np.max(np.abs(whole[::2, :4] - before[:, :4]), axis=0)
            angle = float(max(change[2:])) + 2 * solved[1]
            position = float(max(change[:2])) + 2 * solved[1] * size
            if angle <= accuracy and position <= accuracy * size:
                return Orbit(whole, before, angle, position)
        before, positions = whole, whole[:, :4]
        half *= 2
    return None


def _least_size(packed: Array) -> float:
    """Smallest scale of x, y, m. If pendulums balance a bow, the disk is at rest."""
    return _MIN_BOW_RATIO * float(np.hypot(packed[BX], packed[BY]))
