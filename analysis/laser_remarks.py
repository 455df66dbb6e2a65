"""Effects other than the rotor's motion in the laser signals at a point: wander and steady lines; lines are removed.

Orders 1 to 3 are fitted over the whole interval with amplitudes that are polynomials of time. A fit window by window
would leave lines of its own at the borders of the windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.laser_disturbances import SteadyLine, Wander, lines_in, sentences, thinned, wander_in
from daq.signals.run import Run
from rig_basics.arrays import Array

_MAX_DURATION_S, _MIN_SAMPLES = 24.0, 1000
_LATE_SHARE = 0.6  # share of the time since the release that is used: transients have decayed
_MIN_ROTOR_Hz = 2.0  # below, the rotor's orders reach into the band of the wander
_ORDERS, _DEGREE = 3, 6
_ORDER_BAND_Hz = 0.5  # about a fitted order: an approach to the steady state is not a polynomial
_MAX_ORDER = 12  # highest order that may leave a trace
_MIN_LINE_SHARE, _MIN_LINE_NOISE = 1e-4, 0.25  # least line, of the order's amplitude and of one sample's noise


@dataclass(frozen=True)
class LaserRemarks:
    """Effects other than the rotor's motion in both laser signals.

    Attributes:
        sentences: messages for a reader; empty without findings.
        lines: steady lines of x and of y.
    """

    sentences: tuple[str, ...]
    lines: tuple[list[SteadyLine], list[SteadyLine]]

    def without_lines(self, run: Run) -> Run:
        """Return the run without the lines in its laser signals."""
        if not any(self.lines):
            return run
        x, y = (
            sum((line.at(time) for line in lines), np.zeros(len(time)))
            for time, lines in zip((run.x_time_s, run.y_time_s), self.lines, strict=True)
        )
        return replace(run, x_m=run.x_m - x, y_m=run.y_m - y)


def laser_remarks(run: Run, release_s: float, end_s: float) -> LaserRemarks:
    """Examine both laser signals at the end of a point's run.

    Args:
        release_s, end_s: last release and end of the plateau, s since the run's start.
    """
    start = max(end_s - _LATE_SHARE * (end_s - release_s), end_s - _MAX_DURATION_S)
    messages: list[str] = []
    lines: list[list[SteadyLine]] = []
    for name, time, value in (("x", run.x_time_s, run.x_m), ("y", run.y_time_s, run.y_m)):
        kept = (time >= start) & (time <= end_s) & np.isfinite(value)
        wander, found = (
            _of_one(time[kept], value[kept], run.mark_time_s, run.mark_phase_rad)
            if kept.sum() >= _MIN_SAMPLES
            else (None, [])
        )
        messages += sentences(f"laser {name}", wander, found)
        lines.append(found)
    return LaserRemarks(tuple(messages), (lines[0], lines[1]))


def _of_one(time: Array, value: Array, mark_time: Array, mark_phase: Array) -> tuple[Wander | None, list[SteadyLine]]:
    when, shown = thinned(time, value)
    phase = np.interp(when, mark_time, mark_phase)
    turning_Hz = float(phase[-1] - phase[0]) / (2 * math.pi * float(when[-1] - when[0]))
    if turning_Hz < _MIN_ROTOR_Hz:
        return None, []
    rest = _without_orders(when, shown, phase)
    noise = _white(value)
    known = [(turning_Hz * k, _ORDER_BAND_Hz if k <= _ORDERS else 0.0) for k in range(1, _MAX_ORDER + 1)]
    least = max(_MIN_LINE_SHARE * float(np.ptp(shown)) / 2, _MIN_LINE_NOISE * noise)
    wander = wander_in(when, rest, 2 * noise**2 * float(np.median(np.diff(time))))
    return wander, lines_in(time, value, (when, rest), known, least)


def _without_orders(time: Array, value: Array, phase: Array) -> Array:
    """Return the values without orders 1 to 3, whose amplitudes are polynomials of time."""
    middle, half = 0.5 * (time[0] + time[-1]), 0.5 * (time[-1] - time[0])
    slow: Array = np.asarray(np.polynomial.legendre.legvander((time - middle) / half, _DEGREE), np.float64)
    waves = [turned(k * phase) for k in range(1, _ORDERS + 1) for turned in (np.cos, np.sin)]
    basis = np.concatenate([np.ones((len(time), 1)), *(slow * wave[:, None] for wave in waves)], axis=1)
    found: Array = np.asarray(np.linalg.solve(basis.T @ basis, basis.T @ (value - value.mean())), np.float64)
    return np.asarray(value - value.mean() - basis @ found, np.float64)


def _white(value_m: Array) -> float:
    """Return the white noise of one sample, m, from third differences."""
    return float(np.median(np.abs(np.diff(value_m, 3)))) / 0.6745 / math.sqrt(20)
