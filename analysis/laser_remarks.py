# pyright: strict
"""What the lasers show at a point beside the rotor's motion: wander and steady lines; lines are taken out.

Orders 1 to 3 are fitted over the whole stretch, with amplitudes that are polynomials of time: an order that is taken
out window by window would leave lines of its own where a window ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.signals.laser_disturbances import SteadyLine, Wander, lines_in, sentences, thinned, wander_in
from daq.signals.run import Run

Array = NDArray[np.float64]

_LONGEST_S, _FEWEST_SAMPLES = 24.0, 1000
_LATE = 0.6  # share of the time since the release that is looked at: what rang has died down
_SLOWEST_Hz = 2.0  # of the rotor: below, its orders reach into the band of the wander
_ORDERS, _DEGREE = 3, 6
_WIDE_Hz = 0.5  # about an order that is fitted: an approach is no polynomial
_FURTHER = 12  # orders of which a trace may be there
_LEAST_SHARE, _LEAST_OF_NOISE = 1e-4, 0.25  # of the order's amplitude and of a sample's noise: a line to speak of


@dataclass(frozen=True)
class LaserRemarks:
    """What both lasers show beside the motion.

    Attributes:
        sentences: for a reader; empty where nothing is found.
        lines: steady lines of x and of y.
    """

    sentences: tuple[str, ...]
    lines: tuple[list[SteadyLine], list[SteadyLine]]

    def without_lines(self, run: Run) -> Run:
        """The run with the lines taken out of its lasers."""
        if not any(self.lines):
            return run
        x, y = (
            sum((line.at(time) for line in lines), np.zeros(len(time)))
            for time, lines in zip((run.x_time_s, run.y_time_s), self.lines, strict=True)
        )
        return replace(run, x_m=run.x_m - x, y_m=run.y_m - y)


def laser_remarks(run: Run, release_s: float, end_s: float) -> LaserRemarks:
    """Both lasers at the end of a point's run.

    Args:
        release_s, end_s: last release and end of the plateau, s since the run's start.
    """
    start = max(end_s - _LATE * (end_s - release_s), end_s - _LONGEST_S)
    said: list[str] = []
    lines: list[list[SteadyLine]] = []
    for name, time, value in (("x", run.x_time_s, run.x_m), ("y", run.y_time_s, run.y_m)):
        kept = (time >= start) & (time <= end_s) & np.isfinite(value)
        wander, found = (
            _of_one(time[kept], value[kept], run.mark_time_s, run.mark_phase_rad)
            if kept.sum() >= _FEWEST_SAMPLES
            else (None, [])
        )
        said += sentences(f"laser {name}", wander, found)
        lines.append(found)
    return LaserRemarks(tuple(said), (lines[0], lines[1]))


def _of_one(time: Array, value: Array, mark_time: Array, mark_phase: Array) -> tuple[Wander | None, list[SteadyLine]]:
    when, shown = thinned(time, value)
    phase = np.interp(when, mark_time, mark_phase)
    turning_Hz = float(phase[-1] - phase[0]) / (2 * math.pi * float(when[-1] - when[0]))
    if turning_Hz < _SLOWEST_Hz:
        return None, []
    rest = _without_orders(when, shown, phase)
    noise = _white(value)
    known = [(turning_Hz * k, _WIDE_Hz if k <= _ORDERS else 0.0) for k in range(1, _FURTHER + 1)]
    least = max(_LEAST_SHARE * float(np.ptp(shown)) / 2, _LEAST_OF_NOISE * noise)
    wander = wander_in(when, rest, 2 * noise**2 * float(np.median(np.diff(time))))
    return wander, lines_in(time, value, (when, rest), known, least)


def _without_orders(time: Array, value: Array, phase: Array) -> Array:
    """Values less orders 1 to 3, whose amplitudes are polynomials of time."""
    middle, half = 0.5 * (time[0] + time[-1]), 0.5 * (time[-1] - time[0])
    slow: Array = np.asarray(np.polynomial.legendre.legvander((time - middle) / half, _DEGREE), np.float64)
    waves = [turned(k * phase) for k in range(1, _ORDERS + 1) for turned in (np.cos, np.sin)]
    basis = np.concatenate([np.ones((len(time), 1)), *(slow * wave[:, None] for wave in waves)], axis=1)
    found: Array = np.asarray(np.linalg.solve(basis.T @ basis, basis.T @ (value - value.mean())), np.float64)
    return np.asarray(value - value.mean() - basis @ found, np.float64)


def _white(value_m: Array) -> float:
    """White noise of a sample, m, from third differences."""
    return float(np.median(np.abs(np.diff(value_m, 3)))) / 0.6745 / math.sqrt(20)
