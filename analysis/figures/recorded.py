"""Recorded signals that a figure needs, and messages about missing ones."""

from __future__ import annotations

import math

import numpy as np

from analysis.errors import NotEnoughData
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.texts import number_of

LEAST_MARKS = 3


def displacements(run: Run) -> dict[str, tuple[Array, Array]]:
    """Return times and values of the recorded displacements: "x", "y"."""
    both = {"x": (run.x_time_s, run.x_m), "y": (run.y_time_s, run.y_m)}
    return {name: pair for name, pair in both.items() if np.isfinite(pair[1]).any()}


def need_vectors(run: Run, what: str, *, both: bool = False) -> None:
    """Check that 1× vectors can be calculated; the error lists all missing signals.

    Args:
        run: run to be drawn.
        what: name of the figure for the message.
        both: whether x and y are needed; else one suffices.
    Raises:
        NotEnoughData: displacements or index marks are missing.
    """
    there = displacements(run)
    absent = [name for name in "xy" if name not in there]
    lacking: list[str] = []
    if len(absent) == 2:
        lacking.append("no displacement (neither laser has a sample)")
    elif absent and both:
        lacking.append(f"no displacement {absent[0]} (its laser has no sample)")
    if len(run.mark_time_s) < LEAST_MARKS:
        lacking.append(marks_words(run))
    if lacking:
        raise NotEnoughData(
            f"{run.source} ({run.test}): {what} needs {'both displacements' if both else 'a displacement'} and index "
            f"marks of the turning rotor; this log has {' and '.join(lacking)}; give the log of a run-up or of a point"
        )


def marks_words(run: Run) -> str:
    """Describe too few index marks of a run, with the probable reason."""
    marks = len(run.mark_time_s)
    if marks:
        return f"only {number_of(marks, 'index mark')}"
    if math.isfinite(run.motor_start_s):
        return "no index mark, although its motor was commanded to turn: the tachometer detected nothing"
    return "no index mark (the rotor stood, or no tachometer was recorded)"
