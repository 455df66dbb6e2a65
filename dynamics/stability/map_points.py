"""Points of a map by explicit steps in eight lanes, with more steps where the bound exceeds the accuracy."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array
from dynamics.stability.floquet.lanes import LANES, half_turn_matrices, largest_multipliers
from dynamics.stability.map_rigs import MapRigs

LADDER = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)  # steps per half revolution
_BATCH = 128 * LANES  # number of points per task
_NODES = 16 * LANES  # number of points per task if only matrices are computed
Done = Callable[[NDArray[np.intp], Array, Array], None]
"""Called with finished points, their multipliers and bounds."""


def explicit_multipliers(pool: ThreadPoolExecutor, rigs: MapRigs, accuracy: float, done: Done) -> NDArray[np.intp]:
    """Compute largest multipliers of points, with more steps where the bound exceeds the accuracy.

    Args:
        accuracy: relative to max(1, largest modulus).
        done: called from the calling thread.
    Returns:
        Points for which explicit steps are not suitable.
    """
    rung = _first_rung(rigs, accuracy)
    numbers, units = rigs.numbers, rigs.units
    for i, steps in enumerate(LADDER):
        here = np.flatnonzero(rung == i)
        for batch, found, errors in _batches(pool, numbers, units, here, steps):
            met = errors <= accuracy * np.maximum(1.0, found)
            rung[batch] = -1
            rung[batch[~met]] = _next_rung(i, found[~met], errors[~met], accuracy)
            done(batch[met], found[met], errors[met])
    return np.flatnonzero(rung >= 0)


def half_turns(pool: ThreadPoolExecutor, rigs: MapRigs, units: Array, steps: int) -> Array:
    """D Φ(π) of every point, shape (points, 8, 8).

    All points take the same number of steps. The error of the steps is therefore a polynomial in the rigs' numbers and
    as smooth as the matrix.

    Args:
        units: units of the eight states, shape (8,).
        steps: number of steps per half revolution.
    """
    matrices, numbers = np.empty((len(rigs), 8, 8)), rigs.numbers
    pending: list[Future[None]] = []
    for start in range(0, len(rigs), _NODES):
        part = slice(start, start + _NODES)
        pending.append(pool.submit(half_turn_matrices, steps, numbers[part], units, matrices[part]))
    for future in pending:
        future.result()
    return matrices


def _first_rung(rigs: MapRigs, accuracy: float) -> NDArray[np.intp]:
    """Initial index into the ladder of step numbers. An index beyond its end: explicit steps are not suitable.

    Fitted: the finer of n/2 and n steps meets the accuracy if its step is 1.0 radian of the fastest undamped rate at an
    accuracy of 1e-8 and a span of 20 radians. The step decreases with the ninth root of both.
    """
    swing = np.pi * np.maximum(np.max(rigs.swings, axis=0), 1.0)
    stiff = np.pi * np.max(rigs.fades, axis=0)
    length = 1.0 * (accuracy / 1e-8 * 20.0 / swing) ** (1 / 9)
    return np.asarray(np.searchsorted(np.array(LADDER), np.maximum(swing / length, stiff / 2.5)), np.intp)


def _batches(
    pool: ThreadPoolExecutor,
    numbers: Array,
    units: Array,
    points: NDArray[np.intp],
    steps: int,
) -> Iterable[tuple[NDArray[np.intp], Array, Array]]:
    """Run points with one number of steps on all cores. Each batch is yielded when it is finished."""
    if len(points) == 0:
        return
    size = max(LANES, min(_BATCH, -(-len(points) // (2 * LANES)) * LANES))
    pending: dict[Future[None], tuple[NDArray[np.intp], Array, Array]] = {}
    for start in range(0, len(points), size):
        batch = points[start : start + size]
        found, errors = np.empty(len(batch)), np.empty(len(batch))
        future = pool.submit(largest_multipliers, steps, numbers[batch], units[batch], found, errors)
        pending[future] = (batch, found, errors)
    for future in as_completed(pending):
        future.result()
        yield pending[future]


def _next_rung(i: int, found: Array, errors: Array, accuracy: float) -> NDArray[np.intp]:
    """Next index for points that missed the accuracy with LADDER[i] steps. The error decreases with the 8th power."""
    factor = np.nan_to_num((errors / (accuracy * np.maximum(1.0, found))) ** (1 / 8), nan=2.0, posinf=2.0)
    steps = LADDER[i] * np.minimum(1.1 * factor, 4.0)
    return np.maximum(i + 1, np.asarray(np.searchsorted(np.array(LADDER), steps), np.intp))


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
