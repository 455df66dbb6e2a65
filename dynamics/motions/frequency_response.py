"""Response of a rotor to its imbalance over speed, in closed form, and the resulting torque on a light pendulum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.errors import OutsideDomain


@dataclass(frozen=True)
class FrequencyResponse:
    """Steady whirl over speed of a rotor without pendulums or with balanced ones.

    Attributes:
        speed_ratio: Ω, shape (n,).
        amplification: amplitude along x and y divided by the eccentricity S_P/M_S, shape (2, n).
        lag_rad: lag of the displacement along x and y behind the imbalance, 0 … π, shape (2, n).
    """

    speed_ratio: Array
    amplification: Array
    lag_rad: Array


def frequency_response(rig: RigOrParameters, speed_ratio: Array) -> FrequencyResponse:
    """Amplification M ω²/|k − M ω² + iωc| and phase lag arg(k − M ω² + iωc) of both directions.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one; its suspension must be linear.
        speed_ratio: Ω = ω/ω_n1, shape (n,), not negative.
    Raises:
        OutsideDomain: a speed is negative or not finite, the suspension is not linear, or a speed coincides with an
            undamped resonance.
    Source: linear oscillators under S_P ω² e^{iψ}; the source's (2-6) to (2-10), with a four-quadrant arc tangent for
        the lag.
    """
    p = physics_of(rig)
    ratio = np.atleast_1d(np.asarray(speed_ratio, float))
    if not np.all(np.isfinite(ratio) & (ratio >= 0)):
        raise OutsideDomain(f"speed ratios must be finite and not negative, got {speed_ratio!r}")
    if not p.suspension_is_linear:
        raise OutsideDomain("the closed form requires a linear suspension; simulate a run-up for this one")
    speed, own = p.speed_rad_s(1.0) * ratio, p.total_mass_kg
    pairs = zip((p.k1_N_per_m, p.k2_N_per_m), p.damping_Ns_per_m, strict=True)
    stiffness = np.array([k - own * speed**2 + 1j * speed * c for k, c in pairs])
    if np.any(np.abs(stiffness) <= 1e-14 * np.array([[p.k1_N_per_m], [p.k2_N_per_m]])):
        raise OutsideDomain("a speed coincides with an undamped resonance: the whirl amplitude is unbounded")
    return FrequencyResponse(ratio, own * speed**2 / np.abs(stiffness), np.angle(stiffness))


def light_pendulum_torque(lag_rad: float, angle_rad: Array) -> Array:
    """Torque on a pendulum too light to move the rotor, over M R ω² |z|: sin(−lag − θ); isotropic suspension.

    The centre of the centrifugal field is the rotor's rest position. The disk centre z is displaced from it, with the
    lag behind the imbalance. The field component along the pendulum's path is the torque. The pendulum's rest position
    is in the direction of z.

    Args:
        lag_rad: lag of the displacement behind the imbalance, rad.
        angle_rad: θ of the pendulum from the imbalance, positive in the direction of rotation, shape (n,).
    """
    return np.sin(-lag_rad - np.asarray(angle_rad, float))
