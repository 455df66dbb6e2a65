"""States over one revolution of a rotor whose pendulums are at rest on it."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.locked_motion import locked_orbit
from dynamics.steady.singular_points import SingularPoint

PHASES = 32
_TURN = np.exp(2j * np.pi * np.arange(PHASES) / PHASES)


def _held(x: complex, y: complex, speed_rad_s: float, theta_rad: tuple[float, float]) -> Array:
    """States (PHASES, 8) of x = Re(x e^{iψ}), y = Im(y e^{iψ}) with locked pendulums."""
    states, whirl_x, whirl_y = np.zeros((PHASES, 8)), x * _TURN, y * _TURN
    states[:, 0], states[:, 1] = whirl_x.real, whirl_y.imag
    states[:, 2:4] = theta_rad
    states[:, 4], states[:, 5] = -speed_rad_s * whirl_x.imag, speed_rad_s * whirl_y.real
    return states


def circular_whirl(speed_rad_s: float, point: SingularPoint) -> Array:
    """States (PHASES, 8) at equally spaced phases of the circular whirl z of a singular point."""
    return _held(point.z_m, point.z_m, speed_rad_s, point.theta_rad)


def locked_whirl(parameters: RotorParameters, speed_rad_s: float, theta_rad: tuple[float, float]) -> Array:
    """States (PHASES, 8) of the locked orbit (first order), including the static deflection under gravity."""

    x, y = locked_orbit(parameters, speed_rad_s, *theta_rad)
    states = _held(x, y, speed_rad_s, theta_rad)
    states[:, 1] -= parameters.total_mass_kg * parameters.gravity_m_per_s2 / parameters.k2_N_per_m
    return states
