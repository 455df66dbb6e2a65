"""The rotor's phase through index marks, no livelier than the marks show.

A spline through every mark turns a microsecond of stamping noise at 8 revolutions a second into accelerations of
0.03 rad/s², which push the pendulums by more than the damping's own uncertainty. Here the marks are fitted by a cubic
spline with as few pieces as Akaike's criterion asks for: one at constant speed.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PPoly, make_lsq_spline

from dynamics.errors import OutsideDomain
from dynamics.speed_history import SpeedHistory

_FEWEST = 8
_MARKS_PER_PIECE = 2.0


def recorded_speed(time_s: np.ndarray, phase_rad: np.ndarray) -> SpeedHistory:
    """A speed history from noisy marks.

    Args:
        time_s, phase_rad: shape (n,), n ≥ 4, time strictly ascending.
    Raises:
        OutsideDomain: fewer than four marks or time not ascending.
    """
    through = SpeedHistory.from_phases(time_s, phase_rad)  # refuses what is no history
    n = len(time_s)
    if n < _FEWEST:
        return through
    line = np.polynomial.Polynomial.fit(time_s, phase_rad, 1)
    rest = phase_rad - line(time_s)
    best, lowest = None, np.inf
    floor = (4 * np.finfo(float).eps * float(np.max(np.abs(phase_rad)))) ** 2 * n
    pieces = 1
    while pieces <= n / _MARKS_PER_PIECE:
        inner = np.quantile(time_s, np.arange(1, pieces) / pieces)
        knots = np.r_[[time_s[0]] * 4, inner, [time_s[-1]] * 4]
        spline = make_lsq_spline(time_s, rest, knots, 3)
        square = float(np.sum((spline(time_s) - rest) ** 2)) + floor
        free = pieces + 3
        # the correction for few marks keeps a spline from fitting the last of the noise
        criterion = n * np.log(square / n) + 2 * free + 2 * free * (free + 1) / max(0.5, n - free - 1)
        if criterion < lowest:
            best, lowest = spline, criterion
        pieces = int(np.ceil(1.5 * pieces)) if pieces > 1 else 2
    if best is None:
        raise OutsideDomain(f"{n} marks give no speed history")
    parts = PPoly.from_spline(best)
    wide = np.diff(parts.x) > 0
    coefficients = np.ascontiguousarray(parts.c[::-1, wide].T)
    begins = parts.x[:-1][wide]
    slope = float(line.deriv()(0.0))
    coefficients[:, 0] += line(begins)
    coefficients[:, 1] += slope
    return SpeedHistory(np.r_[begins, parts.x[-1]], coefficients)
