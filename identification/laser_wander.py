"""Warnings about slow wander of the lasers in the residuals of a fit."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from daq.signals.laser_disturbances import Wander, sentences, wander_in
from identification.samples import Averages


def wander_sentences(left: Iterable[tuple[str, Averages, NDArray[np.float64]]]) -> list[str]:
    """Return a message for each sensor that wanders, for the record with its largest wander.

    Args:
        left: axis of the sensor, its block averages and their residuals in m, for every record.
    """
    most: dict[str, Wander] = {}
    for axis, averages, rest in left:
        blocks = float(np.median(np.diff(averages.time_s))) if len(averages.time_s) > 1 else 0.0
        white = 2 * averages.noise**2 / float(np.median(averages.count)) * blocks
        found = wander_in(averages.time_s, rest, white)
        if found is not None and (axis not in most or found.rms_m > most[axis].rms_m):
            most[axis] = found
    return [text for axis in sorted(most) for text in sentences(f"laser {axis}", most[axis], ())]
