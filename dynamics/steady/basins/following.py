"""Many releases simulated at once, each until it enters the region of a stable motion."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.arguments import check_number
from dynamics.arrays import Array, Flags, Indices
from dynamics.errors import OutsideDomain
from dynamics.steady.basins.ends import End, packed
from dynamics.steady.basins.pursuit import APART, CAUGHT, END, FACTS, RADIUS, SETTLED, TURNS_A, TURNS_B, pursue
from dynamics.steady.basins.turning import COARSE_RAD, STEP_RAD, RevolutionMap
from rig_basics.thread_pool import ThreadPool

STATED_ERROR_RAD = 1e-6
"""Default distance of a release and its neighbour."""
_SHARE = 0.25  # V, relative to the region's rim, within which a motion counts as caught
_APART_RAD = 0.02  # distance above which release and neighbour count as separated
_FURTHER = 4  # additional time for a caught release to settle, in units of the simulated time
_NEIGHBOUR_DIRECTION = (1.0, -0.6)  # start of the neighbour relative to the release, A and B
_GROUP = 16  # number of releases per task


@dataclass(frozen=True)
class FollowedReleases:
    """Results of many releases; arrays of shape (n,).

    Attributes:
        end: index into the ends, −1 for a release that did not settle.
        caught_s: time after which the motion was in the region of its end, s; NaN if it never was.
        settled_s: time after which it stayed near its end, possibly beyond the simulated time, s; NaN if unknown.
        apart_rad: largest distance from the neighbour before it was caught, inf beyond 0.02.
        amplitude_m: rms distance of the disk centre from its mean in the last simulated revolution.
        turns: turns of A and B relative to the rotor, shape (n, 2).
        last: final states, shape (n, 8).
    """

    end: Indices
    caught_s: Array
    settled_s: Array
    apart_rad: Array
    amplitude_m: Array
    turns: Array
    last: Array

    @property
    def sure(self) -> Flags:
        """Whether a neighbour at the stated error, simulated less accurately, has the same end."""
        return self.apart_rad <= _APART_RAD

    def at(self, chosen: NDArray[Any]) -> FollowedReleases:
        """Selection of the releases."""
        return FollowedReleases(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def put(self, chosen: NDArray[Any], other: FollowedReleases) -> None:
        """Replace the results of some releases."""
        for f in fields(self):
            getattr(self, f.name)[chosen] = getattr(other, f.name)


def follow(
    turning: RevolutionMap,
    starts: Array,
    ends: Sequence[End],
    seconds: float,
    *,
    stated_error_rad: float = STATED_ERROR_RAD,
    progress: Callable[[float], None] | None = None,
    workers: int | None = None,
) -> FollowedReleases:
    """Simulate releases until they enter the region of an end, at most for a given time.

    Args:
        starts: states at ψ = 0, shape (n, 8).
        ends: possible ends.
        seconds: longest simulated time, at least one revolution, s.
        stated_error_rad: distance of the neighbour from the release, rad.
        progress: called with the completed share, 0 … 1.
        workers: number of threads. None: one per core. 1: the calling thread only.
    Raises:
        OutsideDomain: invalid numbers.
    """
    check_number(seconds=seconds, stated_error_rad=stated_error_rad)
    if not 0 < seconds < math.inf:
        raise OutsideDomain(f"seconds must be finite and above 0, got {seconds!r}")
    if not 0 < stated_error_rad <= 0.1 * _APART_RAD:
        raise OutsideDomain(f"stated_error_rad must be above 0, at most {0.1 * _APART_RAD:g}, got {stated_error_rad!r}")
    turns = max(1, math.ceil(seconds / turning.period_s))
    last, facts = np.array(starts, np.float64), np.empty((len(starts), FACTS))
    neighbours = last.copy()
    neighbours[:, 2:4] += stated_error_rad * np.array(_NEIGHBOUR_DIRECTION)
    table = packed(ends, turning)
    motion = (turning.speed_rad_s, turning.pace, (STEP_RAD, COARSE_RAD), turning.system)
    limits = (_SHARE, _APART_RAD, _FURTHER * turns)

    def group(begin: int) -> None:
        for i in range(begin, min(begin + _GROUP, len(last))):
            pursue(last[i], neighbours[i], turns, motion, table, turning.units, limits, facts[i])

    begins = range(0, len(last), _GROUP)
    if workers == 1:
        for begin in begins:
            group(begin)
    else:
        _in_threads(group, begins, workers or os.cpu_count() or 1, progress)
    period = turning.period_s
    return FollowedReleases(
        facts[:, END].astype(np.int64),
        facts[:, CAUGHT] * period,
        facts[:, SETTLED] * period,
        facts[:, APART].copy(),
        facts[:, RADIUS].copy(),
        facts[:, [TURNS_A, TURNS_B]],
        last,
    )


def _in_threads(
    group: Callable[[int], None], begins: Sequence[int], workers: int, progress: Callable[[float], None] | None
) -> None:
    with ThreadPool(workers) as pool:
        waiting = [pool.submit(group, begin) for begin in begins]
        for done, each in enumerate(as_completed(waiting), 1):
            each.result()
            if progress is not None:
                progress(done / len(waiting))
