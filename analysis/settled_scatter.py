"""Scatter of the final angles of repeated start-ups, and their distance from the balancing angles.

Two equal pendulums (or balls) may exchange places. The two angles of each start-up are therefore sorted, so that mirror
images are one final state. Source: docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from analysis.errors import NotEnoughData
from rig_basics.arrays import Array


@dataclass(frozen=True)
class SettledScatter:
    """Scatter of repeated start-ups; angles in rad from the side opposite the imbalance, −π … π.

    Attributes:
        places_rad: final angles of both, the lower angle first, shape (n, 2).
        mean_rad, std_rad: mean and standard deviation between start-ups, lower and higher angle, shape (2,).
        balanced_rad: balancing angles, shape (2,); NaN if balance is impossible.
        amplitude_m: remaining amplitude of each start-up, shape (n,).
    """

    places_rad: Array
    mean_rad: Array
    std_rad: Array
    balanced_rad: Array
    amplitude_m: Array

    @property
    def count(self) -> int:
        """Number of start-ups."""
        return len(self.places_rad)

    @property
    def scatter_rad(self) -> float:
        """Standard deviation of a final angle between start-ups, pooled over both, rad."""
        return math.sqrt(float(np.mean(self.std_rad**2)))

    @property
    def scatter_std_rad(self) -> float:
        """Standard uncertainty of `scatter_rad` for normally distributed angles, rad."""
        return self.scatter_rad / math.sqrt(4 * (self.count - 1))

    @property
    def off_rad(self) -> float:
        """Root mean square distance from the balancing angles, rad."""
        return math.sqrt(float(np.mean((self.places_rad - self.balanced_rad) ** 2)))

    @property
    def amplitude_scatter_m(self) -> float:
        """Standard deviation of the amplitude between start-ups, m."""
        return float(np.std(self.amplitude_m, ddof=1))


def settled_scatter(theta_rad: Array, amplitude_m: Array, balanced: float | None) -> SettledScatter:
    """Return the scatter of start-ups of two equal pendulums or balls.

    Args:
        theta_rad: final θ3, θ4 of each start-up, shape (n, 2).
        amplitude_m: remaining amplitude, shape (n,).
        balanced: balancing angle of either from the side opposite the imbalance, rad; None if balance is impossible.
    Raises:
        NotEnoughData: fewer than two start-ups.
    """
    theta = np.asarray(theta_rad, np.float64)
    if theta.ndim != 2 or theta.shape[1] != 2 or len(theta) < 2:
        raise NotEnoughData(f"scatter of start-ups: expected two or more with two angles each, got shape {theta.shape}")
    places = np.sort(np.angle(np.exp(1j * (theta - math.pi))), axis=1)
    there = np.full(2, math.nan) if balanced is None else np.array([-balanced, balanced])
    return SettledScatter(
        places, places.mean(axis=0), places.std(axis=0, ddof=1), there, np.asarray(amplitude_m, np.float64)
    )


def more_consistent(one: SettledScatter, other: SettledScatter) -> float:
    """Return the probability that two series of equal scatter differ at least as much, with `one` the smaller.
    Source: F test on the pooled variances of both places.
    """
    if other.scatter_rad == 0.0:
        return 1.0
    freedom = 2 * (one.count - 1), 2 * (other.count - 1)
    return float(scipy.stats.f.cdf((one.scatter_rad / other.scatter_rad) ** 2, *freedom))
