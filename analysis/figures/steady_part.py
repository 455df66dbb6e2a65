"""Interval of a run at one speed for figures of a steady motion: its last seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.errors import NotEnoughData
from analysis.figures.recorded import LEAST_MARKS, marks_words
from analysis.steady_state import AVERAGE_S, plateau_end
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.texts import distinct, number_of
from rig_basics.units import TO_RPM

_MIN_TURNS = 4.0
_MAX_SPEED_RANGE = 0.01  # relative range of the revolutions' speeds in an interval at one speed
_MIN_HELD_S = 3.0  # yields spectra with a resolution better than 1 Hz


@dataclass(frozen=True)
class SteadyPart:
    """Last seconds of a run at one speed.

    Attributes:
        from_s, to_s: start and end, s since the run's start.
        speed_rad_s: mean speed.
        release_s: last release of a pendulum; NaN without one.
    """

    from_s: float
    to_s: float
    speed_rad_s: float
    release_s: float

    def cut(self, time: Array, values: Array) -> tuple[Array, Array]:
        """Return the finite samples in the interval."""
        good = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
        inside = (time >= self.from_s) & (time <= self.to_s) & good
        return time[inside], values[inside]

    def last_turns(self, turns: float) -> SteadyPart:
        """Return the interval of the last `turns` revolutions."""
        start = max(self.from_s, self.to_s - 2 * math.pi * turns / self.speed_rad_s)
        return SteadyPart(start, self.to_s, self.speed_rad_s, self.release_s)


def steady_part(run: Run) -> SteadyPart:
    """Return the last seconds at the run's last speed, without the stop.

    Raises:
        NotEnoughData: the rotor did not turn, or turned fewer than four revolutions.
    """
    if len(run.mark_time_s) < LEAST_MARKS:
        raise NotEnoughData(
            f"{run.source} ({run.test}): expected index marks of a turning rotor, the log has {marks_words(run)}"
        )
    release = max((r.time_s for r in run.releases), default=math.nan)
    begin = float(run.mark_time_s[-3]) - AVERAGE_S if math.isnan(release) else release
    end = plateau_end(run.mark_time_s, run.mark_phase_rad, min(begin, float(run.mark_time_s[-3])))
    start = max(end - AVERAGE_S, float(run.mark_time_s[0]), -math.inf if math.isnan(release) else release)
    first, last = np.interp([start, end], run.mark_time_s, run.mark_phase_rad).tolist()
    if last - first < 2 * math.pi * _MIN_TURNS:
        found, needed = distinct((last - first) / (2 * math.pi), _MIN_TURNS)
        raise NotEnoughData(f"{run.source}: {number_of(found, 'revolution')} at its end, at least {needed} needed")
    return SteadyPart(start, end, (last - first) / (end - start), release)


def held_part(run: Run) -> SteadyPart:
    """Return the longest interval at one speed of a run that passes through speeds.

    Raises:
        NotEnoughData: no interval is long enough for a spectrum; the text contains the speeds of the run.
    """
    time, phase = run.mark_time_s, run.mark_phase_rad
    speed = np.diff(phase) / np.diff(time)
    best, first = (0, 0), 0
    for last in range(len(speed)):
        while np.ptp(speed[first : last + 1]) > _MAX_SPEED_RANGE * abs(float(np.mean(speed[first : last + 1]))):
            first += 1
        if time[last + 1] - time[first] > time[best[1]] - time[best[0]]:
            best = (first, last + 1)
    start, end = float(time[best[0]]), float(time[best[1]])
    if end - start < _MIN_HELD_S:
        raise NotEnoughData(
            f"{run.source} ({run.test}): expected a speed that stays within 1 % for {_MIN_HELD_S:g} s, it goes from "
            f"{TO_RPM * float(speed[0]):.1f} to {TO_RPM * float(speed[-1]):.1f} rpm and stays for {end - start:.1f} s "
            "at most: one spectrum of it would smear every order; draw its waterfall or its orders instead"
        )
    release = max((r.time_s for r in run.releases), default=math.nan)
    return SteadyPart(start, end, float(phase[best[1]] - phase[best[0]]) / (end - start), release)
