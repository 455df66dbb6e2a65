"""Decision whether the rig has settled, used by the guided test while it records and by the analysis of the log.

The decision uses means over whole revolutions in consecutive windows, which do not depend on the ripple of a periodic
orbit (daq.signals.window_means), and a bound on the remaining change (daq.signals.approach). The rig has settled if the
bound, which includes the encoders' quantisation and the noise, is below the tolerance. A drift that does not decrease
has no bound. Examples are a creeping pendulum, and one that leaves an unstable balance, where the drift is tiny for
many seconds and grows. If the decision is uncertain, the rig has not settled and the test continues to record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.approach import Approach, bound
from daq.signals.decay import MIN_WINDOWS
from daq.signals.window_means import WindowMeans, amplitude_means, angle_means, whole_revolutions
from rig_basics.arrays import Array
from rig_basics.texts import number_of

_SAME_GAP_RAD = math.radians(5.0)  # pendulums this close to their gap at release may still be on an unstable balance
WINDOW_S = 1.0
"""Least length of a window, s, which is rounded up to whole revolutions: a decision changes with its newest one."""
_MAX_WINDOWS = 30  # since the release
_LOCKED_TOLERANCE_M = 5e-6
DISPLACEMENTS_S = 40.0
"""The newest displacements that a decision needs, s: more than its windows. With fewer it is another decision."""
# Smallest width of a mean as a share of the tolerance. Angles show the departure from an unstable balance, small at
# first; amplitudes need only be steady, and may wander with temperature and speed for any time.
_MIN_WIDTH_ANGLE, _MIN_WIDTH_AMPLITUDE = 1 / 50, 1 / 10
_FAR = 20  # tolerances: with a larger change over two windows, older windows are not needed


@dataclass(frozen=True)
class Settling:
    """The decision and its reasons.

    Attributes:
        settled: True if the remaining change is below the tolerance.
        slipping: True if a pendulum turns steadily relative to the rotor.
        why: reason in one sentence.
        drift_rad: change of the mean angles over the last window, of the pendulum with the larger change, rad; NaN
            without angles.
        remaining_rad: bound on the angles' remaining change after the last window, rad; inf for a drift that does not
            decrease.
        mean_off_rad: bound on the difference between the angles' mean over the last `average_s` and their end, rad.
        drift_m, remaining_m, mean_off_m: the same for the order-1 amplitudes of x and y, m.
        span_s: time covered by the windows, s.
        more_s: estimated time until everything has settled, s; inf if no end can be predicted.
        approaching: True if a bounded remaining change is the only reason against.
        is_level: True if in addition the means have changed by less than the tolerances over the last window.
    """

    settled: bool
    slipping: bool
    why: str
    drift_rad: float
    remaining_rad: float
    drift_m: float
    remaining_m: float
    span_s: float
    mean_off_rad: float = math.nan
    mean_off_m: float = math.nan
    more_s: float = math.inf
    approaching: bool = False
    is_level: bool = False


@dataclass(frozen=True)
class RotorSignals:
    """Signals of a turning rotor on one clock, up to the time of the decision.

    Attributes:
        angle_time_s, angle_rad: encoder samples, shapes (k,), (k, 2), rad, unwrapped.
        mark_time_s, mark_phase_rad: tachometer marks and ψ there (rad, unwrapped), shape (n,).
        x_time_s, x_m, y_time_s, y_m: lasers, each with its own times; NaN if invalid.
    """

    angle_time_s: Array
    angle_rad: Array
    mark_time_s: Array
    mark_phase_rad: Array
    x_time_s: Array
    x_m: Array
    y_time_s: Array
    y_m: Array

    def amplitude_means(self, edges_s: Array, newest: int) -> WindowMeans | None:
        """Order-1 amplitudes of x and y in windows; arguments and result as in daq.signals.window_means."""
        lasers = (self.x_time_s, self.x_m, self.y_time_s, self.y_m)
        return amplitude_means(*lasers, self.mark_time_s, self.mark_phase_rad, edges_s, newest)


@dataclass(frozen=True, kw_only=True)
class SettlingLimits:
    """Limits of a decision.

    Attributes:
        angle_tolerance_rad, amplitude_tolerance_m: largest allowed remaining change.
        linger_s: time after release before which a pendulum pair that still has its gap at release is not accepted as
            settled, s: it leaves an unstable balance exponentially, too slowly at first to be detected.
        average_s: period before the last mark for `mean_off_rad` and `mean_off_m`, s.
    """

    angle_tolerance_rad: float = math.radians(0.1)
    amplitude_tolerance_m: float = 3e-6
    linger_s: float = 30.0
    average_s: float = 2.0


_USUAL_LIMITS = SettlingLimits()


def settled(
    signals: RotorSignals,
    limits: SettlingLimits = _USUAL_LIMITS,
    *,
    angle_step_rad: float,
    release_time_s: float | None = None,
) -> Settling:
    """Decide whether released pendulums and the orbit have reached their steady state at the end of the signals.

    Args:
        signals: angles, tachometer marks and displacements.
        limits: tolerances and windows.
        angle_step_rad: step of the encoders' code; 0 if the angles are not rounded.
        release_time_s: time of the pendulums' release; None if unknown.

    Returns:
        Settling; `settled` is False, with the reason, if the signals are too short or too sparse.

    Source: docs/theory/detection_of_steady_states.md.
    """
    time_s, angle_rad = signals.angle_time_s, signals.angle_rad
    marks = signals.mark_time_s, signals.mark_phase_rad
    edges = whole_revolutions(*marks, WINDOW_S, _MAX_WINDOWS)
    if release_time_s is not None:
        edges = edges[edges >= release_time_s]
    if len(edges) <= MIN_WINDOWS:
        return _too_few("since release")
    if _change(time_s, angle_rad, edges[-4:]) > _FAR * limits.angle_tolerance_rad:
        edges = edges[-MIN_WINDOWS - 1 :]
    angles = angle_means(time_s, angle_rad, *marks, edges, angle_step_rad, MIN_WINDOWS)
    orbit = signals.amplitude_means(edges, MIN_WINDOWS)
    if angles is None or orbit is None:
        missing = "pendulum angles" if angles is None else "displacements"
        return _unknown(f"too many samples of the {missing} are missing")
    turning = _judged(
        "pendulum angles",
        angles,
        (limits.angle_tolerance_rad, _MIN_WIDTH_ANGLE),
        limits.angle_tolerance_rad,
        limits.average_s,
        (180 / math.pi, "°"),
    )
    whirling = _judged_amplitudes(orbit, limits.amplitude_tolerance_m, limits.average_s)
    slip = _slipping(angles.means[-MIN_WINDOWS:])
    held = release_time_s is not None and _still_as_released(
        time_s, angle_rad, angles.means[-1], edges[-1], release_time_s, limits.linger_s
    )
    others = [
        _speed_change(*marks, edges[-MIN_WINDOWS - 1 :]),
        slip,
        "pendulums still stand as released; they may be on an unstable balance" if held else "",
    ]
    return _decision(orbit, turning, whirling, others, slipping=bool(slip))


def locked_settled(signals: RotorSignals) -> Settling:
    """Decide whether the locked orbit is steady, before the pendulums are released: amplitudes to 5 µm.

    The pendulum angles are not used.
    """
    marks = signals.mark_time_s, signals.mark_phase_rad
    edges = whole_revolutions(*marks, WINDOW_S, _MAX_WINDOWS)
    if len(edges) <= MIN_WINDOWS:
        return _too_few("at speed")
    orbit = signals.amplitude_means(edges, MIN_WINDOWS)
    if orbit is None:
        return _unknown("too many samples of the displacements are missing")
    whirling = _judged_amplitudes(orbit, _LOCKED_TOLERANCE_M, WINDOW_S)
    return _decision(orbit, None, whirling, [_speed_change(*marks, edges[-MIN_WINDOWS - 1 :])])


@dataclass(frozen=True)
class _Judged:
    """Angles or amplitudes.

    Attributes:
        drift: change over the last window, of the quantity with the larger change.
        approach: the larger bound of both quantities.
        more_s: time until the remaining change is below its limit, s.
        is_level: whether that change is below the limit.
        why: reason against, in one sentence; may be empty.
    """

    drift: float
    approach: Approach
    is_level: bool = True
    more_s: float = 0.0
    why: str = ""


_NOT_JUDGED = _Judged(math.nan, Approach(math.nan, math.nan, 0.0, 0.0))


def _judged(
    what: str,
    seen: WindowMeans,
    tolerance: tuple[float, float],
    limit: float,
    average_s: float,
    shown: tuple[float, str],
) -> _Judged:
    """Judge the remaining change of two quantities.

    Args:
        what: the quantities, in words.
        tolerance: their tolerance, and the least width of a mean as a share of it.
        limit: largest allowed remaining change.
        average_s: see SettlingLimits.
        shown: factor to the unit of the sentence, and that unit.
    """
    both = [
        bound(seen.edges_s, column, max(float(width), tolerance[0] * tolerance[1]), average_s, _FAR * tolerance[0])
        for column, width in zip(seen.means.T, seen.width, strict=True)
    ]
    worst = max(both, key=lambda each: each.remaining)
    worst = replace(worst, mean_off=max(each.mean_off for each in both))
    drift = float(np.abs(seen.means[-1] - seen.means[-2]).max())
    factor, unit = shown
    is_level = drift <= limit
    if worst.remaining <= limit:
        return _Judged(drift, worst, is_level)
    if math.isinf(worst.remaining):
        why = f"{what} drift by {drift * factor:.2g}{unit} per window and the drift does not shrink"
        return _Judged(drift, worst, is_level, math.inf, why)
    more_s = math.log(worst.remaining / limit) / worst.rate_per_s if worst.rate_per_s > 0 else math.inf
    why = f"{what} may still change by {worst.remaining * factor:.2g}{unit}, the limit is {limit * factor:.2g}{unit}"
    return _Judged(
        drift, worst, is_level, more_s, why + (f"; about {math.ceil(more_s)} s more" if more_s < math.inf else "")
    )


def _judged_amplitudes(orbit: WindowMeans, tolerance_m: float, average_s: float) -> _Judged:
    """Judge the amplitudes. Coloured noise raises their limit to the width of a mean.

    A change that wandering lasers cannot resolve is detected by the pendulum angles, which the orbit follows.
    """
    visible = max(tolerance_m, float(orbit.width.max())) if orbit.coloured else tolerance_m
    least = (tolerance_m, _MIN_WIDTH_AMPLITUDE)
    return _judged("amplitudes", orbit, least, visible, average_s, (1e6, " µm"))


def _decision(
    orbit: WindowMeans, turning: _Judged | None, whirling: _Judged, others: list[str], *, slipping: bool = False
) -> Settling:
    """Return the decision: with the first reason against, or with the statement that everything is steady.

    Args:
        turning: the angles; None if they are not judged.
        others: reasons that are not a remaining change; may be empty texts.
    """
    angles = turning or _NOT_JUDGED
    why = next(filter(None, [*others, angles.why, whirling.why]), "")
    bounded = math.isfinite(angles.approach.remaining) and math.isfinite(whirling.approach.remaining)
    lasting = math.inf if slipping else max(angles.more_s, whirling.more_s)
    approaching = bounded and bool(why) and not any(others)
    return Settling(
        settled=not why,
        slipping=slipping,
        why=why or f"{'angles and ' if turning else ''}amplitudes are steady",
        drift_rad=angles.drift,
        remaining_rad=angles.approach.remaining,
        drift_m=whirling.drift,
        remaining_m=whirling.approach.remaining,
        span_s=float(orbit.edges_s[-1, 1] - orbit.edges_s[0, 0]),
        mean_off_rad=angles.approach.mean_off,
        mean_off_m=whirling.approach.mean_off,
        more_s=lasting if why else 0.0,
        approaching=approaching,
        is_level=approaching and angles.is_level and whirling.is_level,
    )


def _too_few(since: str) -> Settling:
    return _unknown(f"fewer than {number_of(MIN_WINDOWS, 'window')} of {WINDOW_S:g} s {since}")


def _unknown(why: str) -> Settling:
    return Settling(False, False, why, math.nan, math.inf, math.nan, math.inf, 0.0)


def _change(time: Array, angles: Array, edges: Array) -> float:
    """Return the rough change of the mean angles over a few windows, the larger pendulum's; NaN for empty windows."""
    parts = np.split(angles, np.searchsorted(time, edges))[1:-1]
    means = np.array([part.mean(axis=0) for part in parts if len(part)])
    return float(np.ptp(means, axis=0).max()) if len(means) == len(parts) else math.nan


def _slipping(angles: Array) -> str:
    """Return a sentence if a pendulum turns steadily relative to the rotor, otherwise an empty text."""
    for name, column in zip("AB", angles.T, strict=True):
        steps = np.diff(column)
        half = len(steps) // 2
        steady = abs(steps[-half:].mean()) > 0.5 * abs(steps[:half].mean())
        if abs(column[-1] - column[0]) > np.pi and steady and (np.all(steps > 0) or np.all(steps < 0)):
            turns = (column[-1] - column[0]) / (2 * np.pi)
            return f"pendulum {name} slips: {turns:+.1f} turns relative to the rotor in the last windows"
    return ""


def _still_as_released(time: Array, angles: Array, now: Array, end: float, release: float, linger: float) -> bool:
    if end - release > linger:
        return False
    begin, last = np.searchsorted(time, release - 0.5, "right"), np.searchsorted(time, release)
    before = angles[begin:last]
    before = before[np.isfinite(before).all(axis=1)]
    if not len(before):
        return False
    start = before.mean(axis=0)
    change = (now[1] - now[0]) - (start[1] - start[0])
    return abs((change + np.pi) % (2 * np.pi) - np.pi) < _SAME_GAP_RAD


def _speed_change(mark_time: Array, mark_phase: Array, edges: Array) -> str:
    """Return a sentence if the speed changes by more than 0.1 % over the windows, otherwise an empty text."""
    speeds = np.diff(np.interp(edges, mark_time, mark_phase)) / np.diff(edges)
    change = (speeds[-2:].mean() - speeds[:2].mean()) / speeds.mean()
    return f"the speed still changes, by {100 * change:+.2f} % over the last windows" if abs(change) > 1e-3 else ""
