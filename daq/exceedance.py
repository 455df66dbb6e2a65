# pyright: strict
"""When a signal is beyond a limit, and not just one sample of it, which on a line without a checksum proves nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_TOGETHER = 64  # samples within which a second one beyond the limit confirms the first


class Exceedance:
    """Watches one signal, however it is split into batches.

    A motion beyond the limit shows in the very next sample, or in the next swing; a flipped bit does in neither.

    Args:
        limit: largest magnitude allowed.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._since = _TOGETHER + 1  # samples since the last one beyond the limit

    def feed(self, values: NDArray[np.floating[Any]]) -> float | None:
        """Take the next samples, NaN for none.

        Args:
            values: shape (n,).
        Returns:
            The largest magnitude among them, if two samples close together lie beyond the limit; otherwise None.
        """
        magnitude = np.abs(values)
        beyond = np.flatnonzero(magnitude > self._limit)
        if not len(beyond):
            self._since += len(values)
            return None
        apart = np.diff(beyond, prepend=-self._since)
        self._since = len(values) - int(beyond[-1])
        return float(np.nanmax(magnitude)) if int(apart.min()) <= _TOGETHER else None
