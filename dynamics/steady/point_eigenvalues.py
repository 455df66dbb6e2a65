"""Eigenvalues of small motions about a singular point: growth or decay of each mode in the rotating frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics.arguments import check_speed
from dynamics.arrays import Complex, Indices
from dynamics.equations.linearised import rotating_frame
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.errors import OutsideDomain
from dynamics.steady.singular_points import SingularPoint
from dynamics.steady.whirl import circular_whirl

_ROUNDING = 1e-13  # relative to the matrix's norm


def point_eigenvalues(rig: RigOrParameters, speed_rad_s: float, points: Sequence[SingularPoint]) -> Complex:
    """Eigenvalues λ of δẏ = A δy about singular points of an isotropic rig, in the frame that rotates with the rotor.

    The multipliers over one revolution are e^{2πλ/ω}. For large λ the eigenvalues keep information that these lose.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one; isotropic, with both pendulums, without gravity.
        speed_rad_s: running speed, rad/s, above 0.
        points: result of dynamics.steady.singular_points.singular_points for this rig and speed.
    Returns:
        Shape (points, 8), 1/s, the largest real part first.
    Raises:
        OutsideDomain: another suspension, gravity, an absent pendulum, or a speed not above 0.
    Source: the source's (3-26) to (3-32), with the matrix derived from its energies (dynamics.equations.linearised).
    """
    p = physics_of(rig)
    check_speed(speed_rad_s, p.natural_frequencies_rad_s)
    if not (p.a.present and p.b.present):
        raise OutsideDomain("eigenvalues of singular points: expected both pendulums, got one with mass 0")
    found = np.empty((len(points), 8), np.complex128)
    for own, point in zip(found, points, strict=True):
        matrix = rotating_frame(p, circular_whirl(speed_rad_s, point)[0], speed_rad_s)
        values: Complex = np.asarray(np.linalg.eigvals(np.asarray(matrix.at(0.0))), np.complex128)
        own[:] = values[np.argsort(-values.real)]
    return found


def stability_of(eigenvalues: Complex) -> Indices:
    """1 if all eigenvalues of a point have a negative real part, −1 if one has a positive real part, 0 within rounding.

    Args:
        eigenvalues: shape (…, 8), 1/s.
    Returns:
        Shape (…).
    """
    largest, rounding = eigenvalues.real.max(axis=-1), _ROUNDING * np.abs(eigenvalues).max(axis=-1)
    return np.where(largest < -rounding, 1, np.where(largest > rounding, -1, 0))
