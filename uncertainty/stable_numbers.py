# pyright: strict
"""When the numbers of a Monte Carlo calculation are stable: their scatter between batches of trials."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uncertainty.coverage import IntervalKind, numerical_tolerance, shortest_interval, symmetric_interval
from uncertainty.group import correlation_of

LEAST_BATCHES = 10
"""JCGM 101, 7.9.4 may end after two batches, whose two values leave one degree of freedom for their scatter."""


class Stability:
    """Scatter between batches of what is to be stable.

    Watched are the mean, the standard deviation and the interval's ends of each quantity (JCGM 101, 7.9.4), and the
    largest eigenvalue of the correlation matrix (JCGM 102, 7.8.3).

    Args:
        digits: significant digits of the standard deviation, and of the eigenvalue, that are to be stable.
        level: coverage probability of the interval.
        interval: which of the intervals.
    """

    def __init__(self, digits: int, level: float, interval: IntervalKind) -> None:
        self.digits, self.level = digits, level
        self.interval = symmetric_interval if interval == "symmetric" else shortest_interval
        self.found: list[NDArray[np.float64]] = []
        self.eigenvalues: list[float] = []

    def settled_with(self, values: NDArray[np.float64]) -> bool:
        """Whether all is stable after one more batch, shape (batch, quantities)."""
        origin = values[0]  # what is constant is then exactly 0
        shifted = values - origin
        ordered = np.sort(shifted, axis=0)
        ends = np.array([self.interval(column, self.level) for column in ordered.T])
        covariance = np.atleast_2d(np.cov(shifted, rowvar=False))
        centre, std = np.mean(shifted, axis=0), np.sqrt(np.diag(covariance))
        self.found.append(np.column_stack([origin + centre, std, origin[:, None] + ends]))
        self.eigenvalues.append(float(np.linalg.eigvalsh(correlation_of(covariance))[-1]))
        return self._settled()

    def _settled(self) -> bool:
        """Twice the scatter of each mean over the batches is within the numerical tolerance."""
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
