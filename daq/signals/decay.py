"""Window means of decaying shapes, and the series of newest windows to which they are fitted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MIN_WINDOWS = 9
_SHORTER = 0.7  # share of the windows that is kept if nothing fits all


def decay_means(rates: NDArray[Any], edges_s: NDArray[np.float64]) -> NDArray[Any]:
    """Mean of e^{−λ(t−T)} in each window, shape (rates, windows); a complex λ gives an oscillation.

    Args:
        rates: λ, 1/s.
        edges_s: start and end of each window, shape (n, 2), s; T is the end of the last one.
    """
    middle = edges_s.mean(axis=1) - edges_s[-1, 1]
    half = 0.5 * np.diff(edges_s, axis=1)[:, 0]
    x = rates[:, None] * half
    with np.errstate(over="ignore", invalid="ignore"):  # a fast rate over long windows is not finite
        return np.exp(-rates[:, None] * middle) * np.sinh(x) / x


def newest_counts(count: int) -> list[int]:
    """Return the numbers of newest windows to examine, largest first."""
    counts = [count]
    while counts[-1] > MIN_WINDOWS:
        counts.append(max(MIN_WINDOWS, int(counts[-1] * _SHORTER)))
    return counts
