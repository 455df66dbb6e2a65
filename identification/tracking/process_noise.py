"""Process noise of the filter: growth of the states' variances between readings."""

from __future__ import annotations

import numpy as np

from dynamics.equations.parameters import RotorParameters
from rig_basics.arrays import Array

AT_REST_RAD_S = 0.5
"""Rotor speed below which the imbalance force is negligible, rad/s."""
_MODEL_SHARE, _IMBALANCE_SHARE = 0.004, 0.25  # model error as share of the imbalance force; factor on the std of S_P
_WANDER = 3e-3  # random walk of ln c per square root of a second
_SWING_SHARE = 0.1  # share of a pendulum's speed that bearings and a touch of the hand change in a second


def process_noise(p: RotorParameters, speed_rad_s: float, swing_rad_s: Array, imbalance_std: float) -> Array:
    """Return the growth of the variances per second by model errors, which act as forces on disk and pendulums.

    The imbalance has an error of a few per cent. Its force turns with the rotor, so it is nearly constant over ten
    milliseconds and similar to noise over longer times.

    Args:
        p: parameters.
        speed_rad_s: rotor speed, rad/s.
        swing_rad_s: rates of A and B relative to the rotor, rad/s, shape (2,).
        imbalance_std: relative standard deviation of S_P.
    Returns:
        Shape (10,), in the order of the filter's states.
    """
    if abs(speed_rad_s) < AT_REST_RAD_S:  # no imbalance force; pendulums at rest contain no information on damping
        swing = (_SWING_SHARE * swing_rad_s) ** 2 + 1e-8
        return np.r_[np.zeros(4), 1e-10, 1e-10, swing, _WANDER**2, _WANDER**2]
    force = max(abs(speed_rad_s), *p.natural_frequencies_rad_s) ** 2 * p.imbalance_moment_kg_m / p.total_mass_kg
    share = _MODEL_SHARE + _IMBALANCE_SHARE * imbalance_std
    disk = (share * force) ** 2 * 0.01
    pendulum = (share * force / min(p.a.length_m, p.b.length_m)) ** 2 * 0.01
    return np.r_[np.zeros(4), disk, disk, pendulum, pendulum, _WANDER**2, _WANDER**2]
