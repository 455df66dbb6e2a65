# pyright: strict
"""How sure a share is that was counted."""

from __future__ import annotations

from scipy.special import betaincinv  # pyright: ignore[reportMissingTypeStubs]


def binomial_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's interval of a share.

    Args:
        hits: of the trials, 0 … trials.
        trials: at least 1.
        level: of confidence, 0 … 1.
    """
    tail = 0.5 * (1 - level)
    low = float(betaincinv(hits, trials - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, trials - hits, 1 - tail)) if hits < trials else 1.0
    return low, high
