"""Detection of a signal that exceeds a limit. A single sample is not sufficient, since links may have no checksum."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
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
        count, size = len(values), np.abs(values)
        if count and size.max() <= self._limit:  # the usual case; false with an invalid sample
            self._since += count
            return SampleSummary(0, 0, float(values[-1]), None)
        valid = np.flatnonzero(~np.isnan(values))
        beyond = np.flatnonzero(size > self._limit)
        apart = int(np.min(np.diff(beyond, prepend=-self._since), initial=TOGETHER + 1))
        self._since = count - int(beyond[-1]) if len(beyond) else self._since + count
        if not len(valid):
            return SampleSummary(count, count, math.nan, None)
        last = int(valid[-1])
        largest = float(np.nanmax(size)) if apart <= TOGETHER else None
        return SampleSummary(count - len(valid), count - 1 - last, float(values[last]), largest)

    def feed(self, values: NDArray[np.floating[Any]]) -> float | None:
        """Process the next samples and return `SampleSummary.beyond`."""
        return self.look(values).beyond
