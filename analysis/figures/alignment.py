# pyright: strict
"""Two runs over each other in time: by what happened in both, not by when their logs began."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.figures.recorded import LEAST_MARKS, displacements
from daq.signals.run import Run

Array = NDArray[np.float64]

_SMOOTH_S = 5e-3  # far below a swing of the column, far above a sample of a laser
_SEEN = 30.0  # times its noise, the deflection of something that was plucked


@dataclass(frozen=True)
class Alignment:
    """How a second run lies over a first.

    Attributes:
        shift_s: to be added to the second run's times.
        words: what coincides, a sentence.
    """

    shift_s: float
    words: str


def aligned(run: Run, over: Run, name: str) -> Alignment:
    """The second run's shift: releases coincide, else first motor commands, else plucks, else the logs' starts.

    Args:
        name: of the second run, for the sentence.
    """
    for (what, own), (_, other) in zip(_events(run), _events(over), strict=True):
        if math.isfinite(own) and math.isfinite(other):
            return Alignment(own - other, f"{name} is shifted by {_seconds(own - other)} so that the {what} coincide.")
    return Alignment(
        0.0, f"{name} begins where this log begins: the two have no release, motor command or pluck in common."
    )


def _events(run: Run) -> tuple[tuple[str, float], ...]:
    """What may coincide, the best first, and when it happened, s since the run's start; nan: it did not."""
    return (
        ("first releases", _release_s(run)),
        ("first motor commands", run.motor_start_s),
        ("first swings through rest after the pluck", _pluck_s(run)),
    )


def _seconds(shift: float) -> str:
    return f"{shift:+.3f} s".replace("-", "−")


def _release_s(run: Run) -> float:
    return min((release.time_s for release in run.releases), default=math.nan)


def _pluck_s(run: Run) -> float:
    """When the standing rotor first swung through rest after its largest deflection; nan: it was not plucked.

    That is the first swing after it was let go, however long it was held.
    """
    there = displacements(run)
    if len(run.mark_time_s) >= LEAST_MARKS or not there:
        return math.nan
    time, values = max(there.values(), key=lambda pair: float(np.nanstd(pair[1])))
    good = np.isfinite(values)
    time, values = time[good], values[good]
    width = max(1, round(_SMOOTH_S / float(np.median(np.diff(time))))) if len(time) > 1 else 1
    if len(values) < 8 * width:
        return math.nan
    sums = np.concatenate([[0.0], np.cumsum(values - float(np.median(values[-len(values) // 4 :])))])
    smooth, middle = (sums[width:] - sums[:-width]) / width, time[: len(time) - width + 1] + 0.5 * _SMOOTH_S
    noise = float(np.median(np.abs(np.diff(values, 3)))) / 0.6745 / math.sqrt(20) / math.sqrt(width)
    largest = int(np.argmax(np.abs(smooth)))
    across = np.flatnonzero(smooth[largest:] * smooth[largest] < 0)
    if not len(across) or abs(smooth[largest]) < _SEEN * noise:
        return math.nan
    before, after = largest + int(across[0]) - 1, largest + int(across[0])
    share = abs(smooth[before]) / (abs(smooth[before]) + abs(smooth[after]))
    return float(middle[before] + share * (middle[after] - middle[before]))
