"""The rotor's phase at any time of a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.times import seconds


def phase_at(run: Run, time_s: ArrayLike) -> Array:
    """Return ψ at times, shape (n,), rad; NaN outside the marks and in turns with lost marks.

    Between marks, one per turn, ψ is a cubic spline. A straight line would be in error by 0.8° at 3 Hz if the speed
    rises by 10 rpm per second.

    Raises:
        ValueError: the times are dates or text.
    """
    time = np.atleast_1d(seconds(time_s, ValueError))
    if len(run.phase_time_s) > 1:
        return np.interp(time, run.phase_time_s, run.phase_rad, left=np.nan, right=np.nan)
    if len(run.mark_time_s) < 3:
        return np.full(len(time), np.nan)
    marks, phase = np.asarray(run.mark_time_s, np.float64), np.asarray(run.mark_phase_rad, np.float64)
    between = np.asarray(CubicSpline(marks, phase)(time), np.float64)
    turn = np.clip(np.searchsorted(marks, time, side="right") - 1, 0, len(marks) - 2)
    lost = np.abs(np.diff(phase))[turn] > _MAX_TURNS * 2 * np.pi
    outside = (time < marks[0]) | (time > marks[-1])
    return np.where(outside | lost, np.nan, between)


_MAX_TURNS = 8.5
"""Turns without a mark over which a spline is not accurate enough."""


def speed_at(run: Run, time_s: ArrayLike) -> Array:
    """Return ω at times, shape (n,), rad/s, mean over the turn about each; NaN outside the marks.

    Raises:
        ValueError: the times are dates or text.

    Example:
        >>> import numpy as np
        >>> from analysis import speed_at
        >>> from daq import Run
        >>> none, turns = np.empty(0), np.arange(20)
        >>> marks_s = turns / 5.0  # the index passes five times per second
        >>> angles = none, np.empty((0, 2))
        >>> run = Run("run-up", "arrays", 0.0, none, none, none, none, *angles, marks_s, 2 * np.pi * turns)
        >>> speed_at(run, [1.0, 2.0, 99.0]).round(2)
        array([31.42, 31.42,   nan])
    """
    time = np.atleast_1d(seconds(time_s, ValueError))
    marks, phase = np.asarray(run.mark_time_s, np.float64), np.asarray(run.mark_phase_rad, np.float64)
    if len(run.phase_time_s) > 1:
        marks, phase = np.asarray(run.phase_time_s, np.float64), np.asarray(run.phase_rad, np.float64)
    if len(marks) < 2:
        return np.full(len(time), np.nan)
    speed = np.diff(phase) / np.diff(marks)
    return np.interp(time, 0.5 * (marks[1:] + marks[:-1]), speed, left=np.nan, right=np.nan)
