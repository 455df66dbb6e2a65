# pyright: strict
"""Slow wander of the lasers in what a fit leaves of them, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from daq.signals.laser_disturbances import Wander, sentences, wander_in
from identification.samples import Averages


def wander_sentences(left: Iterable[tuple[str, Averages, NDArray[np.float64]]]) -> list[str]:
    """A sentence for each sensor that wanders, by the record in which it does most.

    Args:
        left: sensor's axis, its block averages and what a fit leaves of them in m, of every record.
    """
    most: dict[str, Wander] = {}
    for axis, averages, rest in left:
        blocks = float(np.median(np.diff(averages.time_s))) if len(averages.time_s) > 1 else 0.0
        white = 2 * averages.noise**2 / float(np.median(averages.count)) * blocks
        found = wander_in(averages.time_s, rest, white)
        if found is not None and (axis not in most or found.rms_m > most[axis].rms_m):
            most[axis] = found
    return [said for axis in sorted(most) for said in sentences(f"laser {axis}", most[axis], ())]
