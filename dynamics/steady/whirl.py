"""States over one revolution of a rotor whose pendulums rest on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.motions.locked_motion import locked_orbit
from dynamics.steady.singular_points import SingularPoint

PHASES = 32


def circular_whirl(speed_rad_s: float, point: SingularPoint) -> NDArray[np.floating]:
    """States (PHASES, 8) at equally spaced phases of the circular whirl z of a singular point."""
    q = point.z_m * np.exp(2j * np.pi * np.arange(PHASES) / PHASES)
    v = 1j * speed_rad_s * q
    rest = np.zeros(PHASES)
    a, b = (np.full(PHASES, t) for t in point.theta_rad)
    return np.column_stack([q.real, q.imag, a, b, v.real, v.imag, rest, rest])


def locked_whirl(
    parameters: RotorParameters, speed_rad_s: float, theta_rad: tuple[float, float]
) -> NDArray[np.floating]:
    """States (PHASES, 8) of the locked orbit (its first order), sag under gravity included, pendulums held."""
    x, y = locked_orbit(parameters, speed_rad_s, *theta_rad)
    turn = np.exp(2j * np.pi * np.arange(PHASES) / PHASES)
    rest = np.zeros(PHASES)
    sag = parameters.total_mass_kg * parameters.gravity_m_per_s2 / parameters.k2_N_per_m
    a, b = (np.full(PHASES, t) for t in theta_rad)
    rate = 1j * speed_rad_s
    return np.column_stack(
        [(x * turn).real, (y * turn).imag - sag, a, b, (rate * x * turn).real, (rate * y * turn).imag, rest, rest]
    )
