"""Stability of the results of a Monte Carlo calculation, from their scatter between batches of trials."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uncertainty.coverage import Interval, IntervalKind, numerical_tolerance, shortest_interval, symmetric_interval
from uncertainty.group import correlation_of

LEAST_BATCHES = 10
"""Smallest number of batches. JCGM 101, 7.9.4 allows two, whose scatter has only one degree of freedom."""


class Stability:
    """Test whether the results of successive batches are stable.

    The tested results are the mean, the standard deviation and the interval's ends of each quantity (JCGM 101, 7.9.4),
    and the largest eigenvalue of the correlation matrix (JCGM 102, 7.8.3).

    Args:
        digits: number of significant digits of the standard deviation, and of the eigenvalue, that must be stable.
        level: coverage probability of the interval.
        interval: kind of interval.
    """

    def __init__(self, digits: int, level: float, interval: IntervalKind) -> None:
        self.digits: int = digits
        self.level: float = level
        self.interval: Callable[[NDArray[np.float64], float], Interval] = (
            symmetric_interval if interval == "symmetric" else shortest_interval
        )
        self.found: list[NDArray[np.float64]] = []
        self.eigenvalues: list[float] = []

    def settled_with(self, values: NDArray[np.float64]) -> bool:
        """Add one batch, shape (batch, quantities), and return whether all results are stable."""
        origin = values[0]  # a constant quantity is then exactly 0
        shifted = values - origin
        ordered = np.sort(shifted, axis=0)
        ends = np.array([self.interval(column, self.level) for column in ordered.T])
        covariance = np.atleast_2d(np.cov(shifted, rowvar=False))
        centre, std = np.mean(shifted, axis=0), np.sqrt(np.diag(covariance))
        self.found.append(np.column_stack([origin + centre, std, origin[:, None] + ends]))
        self.eigenvalues.append(float(np.linalg.eigvalsh(correlation_of(covariance))[-1]))
        return self._settled()

    def _settled(self) -> bool:
        """Return whether twice the standard deviation of each mean over the batches is within its tolerance."""
        count = len(self.found)
        if count < LEAST_BATCHES:
            return False
        table = np.array(self.found)  # (batches, quantities, mean | std | low | high)
        doubt = 2.0 * np.std(table, axis=0, ddof=1) / math.sqrt(count)
        rounding = 16.0 * np.finfo(np.float64).eps * np.max(np.abs(table), axis=(0, 2))
        std = np.sqrt(np.mean(table[:, :, 1] ** 2, axis=0) + np.var(table[:, :, 0], axis=0))
        tolerance = np.array([numerical_tolerance(float(u), self.digits) for u in std])
        if bool(np.any(doubt > np.maximum(tolerance, rounding)[:, None])):
            return False
        largest = np.array(self.eigenvalues)
        eigenvalue_doubt = 2.0 * float(np.std(largest, ddof=1)) / math.sqrt(count)
        return eigenvalue_doubt <= numerical_tolerance(float(np.mean(largest)), self.digits)
