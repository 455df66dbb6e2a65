"""Detection of a signal that exceeds a limit. A single sample is not sufficient, since links may have no checksum."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

TOGETHER = 64
"""Largest distance of two samples beyond the limit that confirm each other, samples."""


class Exceedance:
    """Monitors one signal. The result does not depend on its division into batches.

    A motion beyond the limit shows in the next samples or in the next swing. A bit error does not.

    Args:
        limit: largest permitted magnitude.
    """

    def __init__(self, limit: float) -> None:
        self._limit = float(limit)
        self._since = TOGETHER + 1  # samples since the last one beyond the limit

    def feed(self, values: NDArray[np.floating[Any]]) -> float | None:
        """Process the next samples, shape (n,), NaN if invalid.

        Returns:
            The largest magnitude if two samples within `TOGETHER` exceed the limit; otherwise None.
        """
        size = np.abs(values)
        beyond = np.flatnonzero(size > self._limit)
        if not len(beyond):
            self._since += len(values)
            return None
        apart = int(np.min(np.diff(beyond, prepend=-self._since)))
        self._since = len(values) - int(beyond[-1])
        return float(np.nanmax(size)) if apart <= TOGETHER else None
