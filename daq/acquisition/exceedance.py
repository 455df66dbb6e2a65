"""When a signal is beyond a limit, and not just one sample of it, which on a line without a checksum proves nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

TOGETHER = 64
"""Samples within which a second one beyond the limit confirms the first."""


class Look(NamedTuple):
    """What the samples of one read show.

    Attributes:
        invalid: how many are none (NaN).
        invalid_last: how many of those stand at the end, behind every valid one.
        newest: the last valid one; NaN where there is none.
        beyond: the largest magnitude, if two samples close together lie beyond the limit; otherwise None.
    """

    invalid: int
    invalid_last: int
    newest: float
    beyond: float | None


class Exceedance:
    """Watches one signal, however it is split into batches.

    A motion beyond the limit shows in the very next sample, or in the next swing; a flipped bit does in neither.

    Args:
        limit: largest magnitude allowed.
    """

    def __init__(self, limit: float) -> None:
        self._limit = float(limit)
        self._since = TOGETHER + 1  # samples since the last one beyond the limit

    def look(self, values: NDArray[np.floating[Any]]) -> Look:
        """Take the next samples, NaN for none; shape (n,)."""
        own = np.ascontiguousarray(values, np.float64)
        invalid, last, newest, largest, apart, self._since = _look(own, self._limit, self._since)
        return Look(invalid, last, newest, largest if apart <= TOGETHER else None)

    def feed(self, values: NDArray[np.floating[Any]]) -> float | None:
        """Take the next samples; returns what `Look.beyond` says."""
        return self.look(values).beyond


@njit(cache=True, nogil=True)
def _look(
    values: NDArray[np.float64], limit: float, since: int
) -> tuple[int, int, float, float, int, int]:  # pragma: no cover - compiled
    """Look's numbers, the largest magnitude, the least distance of two beyond the limit, samples since the last."""
    invalid = invalid_last = 0
    newest, largest = np.nan, 0.0
    apart = TOGETHER + 1
    for value in values:
        if np.isnan(value):
            invalid += 1
            invalid_last += 1
            since += 1
            continue
        invalid_last, newest = 0, value
        largest = max(largest, abs(value))
        if abs(value) > limit:
            apart = min(apart, since)
            since = 0
        since += 1
    return invalid, invalid_last, newest, largest, apart, since


def compile_look() -> None:
    """Load what is compiled, or compile it, before any sample waits for it."""
    Exceedance(1.0).feed(np.zeros(1))
