"""Alignment of two runs in time by common events instead of the starts of their logs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.figures.recorded import LEAST_MARKS, displacements
from daq.signals.run import Run

_SMOOTH_S = 5e-3  # much shorter than a swing of the column, much longer than a laser's sample interval
_MIN_PLUCK_NOISE = 30.0  # deflection of a pluck over the noise


@dataclass(frozen=True)
class Alignment:
    """Position of a second run relative to a first.

    Attributes:
        shift_s: time to be added to the second run's times.
        words: sentence about the common event.
    """

    shift_s: float
    words: str


def aligned(run: Run, over: Run, name: str) -> Alignment:
    """Return the second run's shift: releases coincide, else first motor commands, else plucks, else the logs' starts.

    Args:
        run, over: first and second run.
        name: name of the second run for the sentence.
    """
    for (what, own), (_, other) in zip(_events(run), _events(over), strict=True):
        if math.isfinite(own) and math.isfinite(other):
            return Alignment(own - other, f"{name} is shifted by {_seconds(own - other)} so that the {what} coincide.")
    return Alignment(
        0.0, f"{name} begins where this log begins: the two have no release, motor command or pluck in common."
    )


def _events(run: Run) -> tuple[tuple[str, float], ...]:
    """Return possible common events, the best first, with their times, s since the run's start; NaN if missing."""
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
    """Return the time of the standing rotor's first swing through rest after its largest deflection; NaN if none.

    This is the first swing after the rotor was released, independent of how long it was held.
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
    if not len(across) or abs(smooth[largest]) < _MIN_PLUCK_NOISE * noise:
        return math.nan
    before, after = largest + int(across[0]) - 1, largest + int(across[0])
    share = abs(smooth[before]) / (abs(smooth[before]) + abs(smooth[after]))
    return float(middle[before] + share * (middle[after] - middle[before]))
