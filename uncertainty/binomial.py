"""Confidence interval of a share that was found by counting."""

from __future__ import annotations

from scipy.special import betaincinv


def binomial_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of a share.

    Args:
        hits: number of trials with a hit, 0 … trials.
        trials: number of trials, at least 1.
        level: confidence level, 0 … 1.
    """
    tail = 0.5 * (1 - level)
    low = float(betaincinv(hits, trials - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, trials - hits, 1 - tail)) if hits < trials else 1.0
    return low, high
