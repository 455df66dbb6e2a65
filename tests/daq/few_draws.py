"""Limits of statistics over few draws, at the false-alarm probability that they have over many."""

from __future__ import annotations

import math

from scipy.stats import binom, chi2


def share_limits(count: int, many: int, low: float, high: float = 1.0) -> tuple[float, float]:
    """Limits of the share of `count` intervals of 95 % that hold, as improbable as `low` and `high` are for `many`."""
    below, above = binom.cdf(math.ceil(low * many) - 1, many, 0.95), binom.sf(math.floor(high * many), many, 0.95)
    return float(binom.ppf(below, count, 0.95)) / count, float(binom.isf(above, count, 0.95)) / count


def square_limits(count: int, many: int, low: float, high: float) -> tuple[float, float]:
    """Limits of the mean square of `count` standard deviates, as improbable as `low` and `high` are for `many`."""
    below, above = chi2.cdf(low * many, many), chi2.sf(high * many, many)
    return float(chi2.ppf(below, count)) / count, float(chi2.isf(above, count)) / count


def mean_limit(count: int, many: int, at: float) -> float:
    """Limit of the mean of `count` deviates, as improbable as `at` is for `many`."""
    return at * math.sqrt(many / count)
