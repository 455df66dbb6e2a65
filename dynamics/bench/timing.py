"""Time of a call on a machine with other load: medians of repeated runs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

_SAMPLE_S = 2e-3  # duration of one sample, far above the resolution of the clock
_MAX_TOTAL_S = 3.0  # duration of all samples together


def median_seconds(action: Callable[[], object], repeats: int = 7) -> float:
    """Median time of a call, s. The first call (compilation, caches) is not counted.

    Args:
        repeats: number of samples. It is reduced, to not less than three, if the samples would take more than a few
            seconds together.
    """
    action()
    once = _sample(action, 1)
    calls = max(1, int(_SAMPLE_S / max(once, 1e-9)))
    fewer = int(_MAX_TOTAL_S / max(once * calls, 1e-9))
    return statistics.median(_sample(action, calls) for _ in range(max(min(3, repeats), min(repeats, fewer))))


def _sample(action: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        action()
    return (time.perf_counter() - start) / calls
