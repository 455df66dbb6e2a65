"""Time of a call on a machine that does other things too: medians of repeated runs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

_SAMPLE_S = 2e-3  # a sample is as many calls as take this long: far above the clock's resolution
_LONGEST_S = 3.0  # of all samples together


def median_seconds(action: Callable[[], object], repeats: int = 7) -> float:
    """Median time of a call; one call that is not counted goes first (compilation, caches).

    Args:
        repeats: samples; fewer, but three if asked for, where they would take more than a few seconds together.
    """
    action()
    once = _sample(action, 1)
    calls = max(1, int(_SAMPLE_S / max(once, 1e-9)))
    fewer = int(_LONGEST_S / max(once * calls, 1e-9))
    return statistics.median(_sample(action, calls) for _ in range(max(min(3, repeats), min(repeats, fewer))))


def _sample(action: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        action()
    return (time.perf_counter() - start) / calls
