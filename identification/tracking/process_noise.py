# pyright: strict
"""How fast the filter's states become uncertain between readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters

Array = NDArray[np.float64]

AT_REST_RAD_S = 0.5
"""A rotor that is slower pushes nothing."""
_MODEL_SHARE, _IMBALANCE_SHARE = 0.004, 0.25  # of the imbalance's force: what the model lacks, and of S_P's own error
_WANDER = 3e-3  # of ln c per square root of a second
_SWING_SHARE = 0.1  # of a pendulum's speed that bearings and a hand's last touch change in a second


def process_noise(p: RotorParameters, speed_rad_s: float, swing_rad_s: Array, imbalance_std: float) -> Array:
    """Growth of variances per second, shape (10,): what the model leaves out pushes disk and pendulums a little.

    The imbalance is taken for wrong by a few per cent; its force turns with the rotor, which over ten milliseconds
    looks like a push, over longer like noise.

    Args:
        swing_rad_s: rates of A and B relative to the rotor, shape (2,).
        imbalance_std: relative standard deviation of S_P.
    """
    if abs(speed_rad_s) < AT_REST_RAD_S:  # no imbalance pushes; that nothing moves must not be taken for damping
        swing = (_SWING_SHARE * swing_rad_s) ** 2 + 1e-8
        return np.r_[np.zeros(4), 1e-10, 1e-10, swing, _WANDER**2, _WANDER**2]
    force = max(abs(speed_rad_s), *p.natural_frequencies_rad_s) ** 2 * p.imbalance_moment_kg_m / p.total_mass_kg
    share = _MODEL_SHARE + _IMBALANCE_SHARE * imbalance_std
    disk = (share * force) ** 2 * 0.01
    pendulum = (share * force / min(p.a.length_m, p.b.length_m)) ** 2 * 0.01
    return np.r_[np.zeros(4), disk, disk, pendulum, pendulum, _WANDER**2, _WANDER**2]
