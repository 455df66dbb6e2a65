# pyright: strict
"""How far repeated start-ups come to rest from each other, and from where the pendulums or balls would balance.

Two alike pendulums (or balls) may change places: of each start-up the two are taken in the order of their angles, so
that mirror images are one ending. Source: docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution  # pyright: ignore[reportMissingTypeStubs]

from analysis.errors import NotEnoughData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SettledScatter:
    """Of repeated start-ups; angles in rad from the far side of the imbalance, −π … π.

    Attributes:
        places_rad: of both, the lower angle first, shape (n, 2).
        mean_rad, std_rad: of the lower and the higher one, shape (2,); std between start-ups.
        balanced_rad: where they balance, shape (2,); nan where they cannot.
        amplitude_m: of each, shape (n,).
    """

    places_rad: Array
    mean_rad: Array
    std_rad: Array
    balanced_rad: Array
    amplitude_m: Array

    @property
    def count(self) -> int:
        """Start-ups."""
        return len(self.places_rad)

    @property
    def scatter_rad(self) -> float:
        """Standard deviation of a place between start-ups, both taken together."""
        return math.sqrt(float(np.mean(self.std_rad**2)))

    @property
    def scatter_std_rad(self) -> float:
        """How well that is known from so many start-ups, were they normal."""
        return self.scatter_rad / math.sqrt(4 * (self.count - 1))

    @property
    def off_rad(self) -> float:
        """Root mean square distance from the balanced places."""
        return math.sqrt(float(np.mean((self.places_rad - self.balanced_rad) ** 2)))

    @property
    def amplitude_scatter_m(self) -> float:
        """Standard deviation of the amplitude between start-ups."""
        return float(np.std(self.amplitude_m, ddof=1))


def settled_scatter(theta_rad: Array, amplitude_m: Array, balanced: float | None) -> SettledScatter:
    """The scatter of start-ups of two alike pendulums or balls.

    Args:
        theta_rad: θ3, θ4 where each came to rest, shape (n, 2).
        amplitude_m: of what was left, shape (n,).
        balanced: angle of either from the far side of the imbalance where they balance, rad; None: they cannot.
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
    """How often two series of equal scatter would differ so much or more with `one` the less scattered.

    Source: F test on the pooled variances of both places.
    """
    if other.scatter_rad == 0.0:
        return 1.0
    freedom = 2 * (one.count - 1), 2 * (other.count - 1)
    return float(f_distribution.cdf((one.scatter_rad / other.scatter_rad) ** 2, *freedom))  # pyright: ignore[reportUnknownMemberType]
