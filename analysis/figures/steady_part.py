# pyright: strict
"""The part of a run at one speed that figures of a steady motion show: its last seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.errors import NotEnoughData
from analysis.figures.recorded import LEAST_MARKS, marks_words
from analysis.steady_state import AVERAGE_S, plateau_end
from daq.signals.run import Run

Array = NDArray[np.float64]

_LEAST_TURNS = 4.0
_HELD = 0.01  # of the speed, from the slowest to the fastest turn of a stretch at one speed
_LEAST_HELD_S = 3.0  # gives spectra lines of less than 1 Hz
_RPM = 30 / math.pi


@dataclass(frozen=True)
class SteadyPart:
    """The last seconds of a run at one speed.

    Attributes:
        from_s, to_s: since the run's start.
        speed_rad_s: mean speed in them.
        release_s: last release of a pendulum; nan without one.
    """

    from_s: float
    to_s: float
    speed_rad_s: float
    release_s: float

    def cut(self, time: Array, values: Array) -> tuple[Array, Array]:
        """Finite samples in it."""
        good = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
        inside = (time >= self.from_s) & (time <= self.to_s) & good
        return time[inside], values[inside]

    def last_turns(self, turns: float) -> SteadyPart:
        """Only so many revolutions at its end."""
        start = max(self.from_s, self.to_s - 2 * math.pi * turns / self.speed_rad_s)
        return SteadyPart(start, self.to_s, self.speed_rad_s, self.release_s)


def steady_part(run: Run) -> SteadyPart:
    """The last seconds at the run's last speed, the stop left out.

    Raises:
        NotEnoughData: the rotor did not turn, or hardly.
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
    if last - first < 2 * math.pi * _LEAST_TURNS:
        raise NotEnoughData(
            f"{run.source}: {(last - first) / (2 * math.pi):.1f} revolutions at its end, at least 4 needed"
        )
    return SteadyPart(start, end, (last - first) / (end - start), release)


def held_part(run: Run) -> SteadyPart:
    """The longest stretch at one speed of a run that goes through speeds.

    Raises:
        NotEnoughData: none is long enough for a spectrum; the text says what the run does instead.
    """
    time, phase = run.mark_time_s, run.mark_phase_rad
    speed = np.diff(phase) / np.diff(time)
    best, first = (0, 0), 0
    for last in range(len(speed)):
        while np.ptp(speed[first : last + 1]) > _HELD * abs(float(np.mean(speed[first : last + 1]))):
            first += 1
        if time[last + 1] - time[first] > time[best[1]] - time[best[0]]:
            best = (first, last + 1)
    start, end = float(time[best[0]]), float(time[best[1]])
    if end - start < _LEAST_HELD_S:
        raise NotEnoughData(
            f"{run.source} ({run.test}): expected a speed that stays within 1 % for {_LEAST_HELD_S:g} s, it goes from "
            f"{_RPM * float(speed[0]):.1f} to {_RPM * float(speed[-1]):.1f} rpm and stays for {end - start:.1f} s at "
            "most: one spectrum of it would smear every order; draw its waterfall or its orders instead"
        )
    release = max((r.time_s for r in run.releases), default=math.nan)
    return SteadyPart(start, end, float(phase[best[1]] - phase[best[0]]) / (end - start), release)
