# pyright: strict
"""How a rotor answers its imbalance over speed, in closed form, and where that pushes a light pendulum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters, physics_of
from dynamics.errors import OutsideDomain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrequencyResponse:
    """Steady whirl of a rotor whose pendulums are absent or balance each other, over speed.

    Attributes:
        speed_ratio: Ω, shape (n,).
        amplification: amplitude along x and y over the eccentricity S_P/M_S, shape (2, n).
        lag_rad: by which the displacement along x and y is behind the imbalance, 0 … π, shape (2, n).
    """

    speed_ratio: Array
    amplification: Array
    lag_rad: Array


def frequency_response(rig: RotorParameters | object, speed_ratio: Array) -> FrequencyResponse:
    """Amplification M ω²/|k − M ω² + iωc| and phase lag arg(k − M ω² + iωc) of both directions.

    Args:
        rig: RotorParameters, or anything whose `.physics` is; its suspension linear.
        speed_ratio: Ω = ω/ω_n1, shape (n,), not negative.
    Raises:
        OutsideDomain: a speed below 0 or not finite, a suspension that is not linear, or a speed exactly in a
            resonance without damping.
    Source: linear oscillators under S_P ω² e^{iψ}; the source's (2-6) to (2-10), the lag by both arguments of the arc
        tangent.
    """
    p = physics_of(rig)
    ratio = np.atleast_1d(np.asarray(speed_ratio, float))
    if not np.all(np.isfinite(ratio) & (ratio >= 0)):
        raise OutsideDomain(f"speed ratios must be finite and not negative, got {speed_ratio!r}")
    if not p.suspension_is_linear:
        raise OutsideDomain("the closed form is that of a linear suspension; simulate a run-up for this one")
    speed, own = p.speed_rad_s(1.0) * ratio, p.total_mass_kg
    pairs = zip((p.k1_N_per_m, p.k2_N_per_m), p.damping_Ns_per_m, strict=True)
    stiffness = np.array([k - own * speed**2 + 1j * speed * c for k, c in pairs])
    if np.any(np.abs(stiffness) <= 1e-14 * np.array([[p.k1_N_per_m], [p.k2_N_per_m]])):
        raise OutsideDomain("a speed lies in a resonance without damping: the whirl grows for ever")
    return FrequencyResponse(ratio, own * speed**2 / np.abs(stiffness), np.angle(stiffness))


def light_pendulum_torque(lag_rad: float, angle_rad: Array) -> Array:
    """Torque on a pendulum too light to move the rotor, over M R ω² |z|: sin(−lag − θ); isotropic suspension.

    The centrifugal field's centre is the rotor's place of rest, from which the disk's centre z is away by the lag
    behind the imbalance. What the field has along the pendulum's path drives it; it rests where z points.

    Args:
        lag_rad: of the displacement behind the imbalance.
        angle_rad: θ of the pendulum from the imbalance, ahead in the sense of rotation, shape (n,).
    """
    return np.sin(-lag_rad - np.asarray(angle_rad, float))
