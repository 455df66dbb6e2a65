"""Detection of a signal that exceeds a limit. A single sample is not sufficient, since links may have no checksum."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

TOGETHER = 64
"""Largest distance of two samples beyond the limit that confirm each other, samples."""


class SampleSummary(NamedTuple):
    """Summary of the samples of one read.

    Attributes:
        invalid: number of invalid samples (NaN).
        invalid_last: number of invalid samples after the last valid one.
        newest: the last valid sample; NaN if there is none.
        beyond: the largest magnitude if two samples within `TOGETHER` exceed the limit; otherwise None.
    """

    invalid: int
    invalid_last: int
    newest: float
    beyond: float | None


class Exceedance:
    """Monitors one signal. The result does not depend on its division into batches.

    A motion beyond the limit shows in the next samples or in the next swing. A bit error does not.

    Args:
        limit: largest permitted magnitude.
    """

    def __init__(self, limit: float) -> None:
        self._limit = float(limit)
        self._since = TOGETHER + 1  # samples since the last one beyond the limit

    def look(self, values: NDArray[np.floating[Any]]) -> SampleSummary:
        """Process the next samples, shape (n,), NaN if invalid, and return their summary."""
        own = np.ascontiguousarray(values, np.float64)
        invalid, last, newest, largest, apart, self._since = _look(own, self._limit, self._since)
        return SampleSummary(invalid, last, newest, largest if apart <= TOGETHER else None)

    def feed(self, values: NDArray[np.floating[Any]]) -> float | None:
        """Process the next samples and return `SampleSummary.beyond`."""
        return self.look(values).beyond


@njit(cache=True, nogil=True)
def _look(
    values: NDArray[np.float64], limit: float, since: int
) -> tuple[int, int, float, float, int, int]:  # pragma: no cover - compiled
    """Return the counts and the newest value of a SampleSummary, and the state of an Exceedance.

    The state is the largest magnitude, the least distance of two samples beyond the limit, and the distance to the last
    one, in samples.
    """
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
    """Compile `_look`, or load it from the cache, so that no sample is delayed by the compilation."""
    Exceedance(1.0).feed(np.zeros(1))
