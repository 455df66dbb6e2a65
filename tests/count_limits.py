"""Limits of a statistical test of fewer draws, at the false-alarm probability that they have with many.

The limits are stated for the thorough run's number of draws; with this number each is returned as it is.
"""

from __future__ import annotations

import math

from scipy.stats import binom, chi2

_SAME = 1 + 1e-9  # a probability that is equal but for rounding is equal


def rms_limits(low: float, high: float, of: int, count: int) -> tuple[float, float]:
    """Limits of the root mean square of `count` normal draws, from those of `of` draws."""
    return mean_square_limit(low**2, of, count) ** 0.5, mean_square_limit(high**2, of, count) ** 0.5


def mean_square_limit(limit: float, of: int, count: int) -> float:
    """Limit of the mean square of `count` normal draws, from that of `of` draws; below or above one."""
    if count == of:
        return limit
    if limit < 1:
        return float(chi2.ppf(chi2.cdf(limit * of, of), count)) / count
    return float(chi2.isf(chi2.sf(limit * of, of), count)) / count


def most(limit: int, of: int, share: float, count: int) -> int:
    """Largest number of hits with a chance of `share` among `count` draws, from that among `of` draws."""
    return int(binom.isf(binom.sf(limit, of, share) * _SAME, count, share))


def fewest(limit: int, of: int, share: float, count: int) -> int:
    """Smallest number of hits with a chance of `share` among `count` draws, from that among `of` draws."""
    return count - most(of - limit, of, 1 - share, count)


def share_limits(count: int, of: int, low: float, high: float = 1.0) -> tuple[float, float]:
    """Limits of the share of `count` intervals of 95 % that hold, from those of `of` intervals."""
    least = fewest(math.ceil(low * of), of, 0.95, count)
    return least / count, most(math.floor(high * of), of, 0.95, count) / count


def square_limits(count: int, of: int, low: float, high: float) -> tuple[float, float]:
    """Limits of the mean square of `count` normal draws, from those of `of` draws."""
    return mean_square_limit(low, of, count), mean_square_limit(high, of, count)


def mean_limit(count: int, of: int, at: float) -> float:
    """Limit of the mean of `count` draws, from that of `of` draws."""
    return at * math.sqrt(of / count)
