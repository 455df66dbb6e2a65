"""Pendulum angles for figures: both unwrapped, with the end within 0…360°."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array

ANGLE_FOOT = (
    "Pendulum angles: relative to the rotor, 0° at the imbalance, positive in the sense of rotation; unwrapped, the "
    "end within 0…360°."
)
_END_S = 1.0
_NEAR_ZERO_DEG = 5.0  # an angle that ends slightly below 0° is drawn there, not at 355°


def whole_turns(time_s: Array, angle_rad: Array) -> Array:
    """Return whole turns to subtract so that the ends of θ3 and θ4 lie within 0…360°, rad, (2,); 0 without samples."""
    found = np.zeros(2)
    for j in range(2):
        good = np.isfinite(angle_rad[:, j])
        if good.any():
            late: NDArray[np.bool_] = good & (time_s >= time_s[good][-1] - _END_S)
            end = math.degrees(float(np.mean(np.asarray(angle_rad[late, j], np.float64))))
            found[j] = 2 * math.pi * math.floor((end + _NEAR_ZERO_DEG) / 360.0)
    return found


def degree_ticks(low_deg: float, high_deg: float) -> tuple[Array, tuple[float, float]]:
    """Return four to seven ticks at 45°, 90°, 180° or whole turns, and limits of the axis with a margin."""
    steps = np.array(
        [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0, 1800.0, 3600.0, 18000.0]
    )
    step = float(steps[min(int(np.searchsorted(steps, (high_deg - low_deg) / 5.0)), len(steps) - 1)])
    low, high = step * math.floor(low_deg / step), step * math.ceil(high_deg / step)
    if high <= low:
        high = low + step
    room = 0.04 * (high - low)
    return np.arange(low, high + step / 2, step), (low - room, high + room)
