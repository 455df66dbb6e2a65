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
from daq.signals.window_means import WindowMeans, amplitude_means, angle_means, whole_revolutions
from rig_basics.arrays import Array
from rig_basics.texts import number_of

_SAME_GAP_RAD = math.radians(5.0)  # pendulums this close to their gap at release may still be on an unstable balance
_MAX_WINDOWS = 30
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
        window_s, windows: least length of a window (rounded up to whole revolutions) and the least number of them; up
            to 30 windows since the release are used.
        linger_s: time after release before which a pendulum pair that still has its gap at release is not accepted as
            settled, s: it leaves an unstable balance exponentially, too slowly at first to be detected.
        average_s: period before the last mark for `mean_off_rad` and `mean_off_m`, s.
        slack: number of tolerances that the remaining change may have; the width of a mean depends on the tolerances
            themselves.
    """

    angle_tolerance_rad: float = math.radians(0.1)
    amplitude_tolerance_m: float = 3e-6
    window_s: float = 1.0
    windows: int = 9
    linger_s: float = 30.0
    average_s: float = 2.0
    slack: float = 1.0


_USUAL_LIMITS = SettlingLimits()


def settled(
    signals: RotorSignals,
    limits: SettlingLimits = _USUAL_LIMITS,
    *,
    release_time_s: float | None = None,
    angle_step_rad: float | None = None,
) -> Settling:
    """Decide whether released pendulums and the orbit have reached their steady state at the end of the signals.

    Args:
        signals: angles, tachometer marks and displacements.
        limits: tolerances and windows.
        release_time_s: time of the pendulums' release; None if unknown.
        angle_step_rad: step of the encoders' code; None: the smallest change in the samples.

    Returns:
        Settling; `settled` is False, with the reason, if the signals are too short or too sparse.

    Source: docs/theory/detection_of_steady_states.md.
    """
    time_s, angle_rad, windows = signals.angle_time_s, signals.angle_rad, limits.windows
    marks = signals.mark_time_s, signals.mark_phase_rad
    edges = whole_revolutions(*marks, limits.window_s, _MAX_WINDOWS)
    if release_time_s is not None:
        edges = edges[edges >= release_time_s]
    if len(edges) <= windows:
        return _unknown(f"fewer than {number_of(windows, 'window')} of {limits.window_s:g} s since release")
    if _change(time_s, angle_rad, edges[-4:]) > _FAR * limits.angle_tolerance_rad:
        edges = edges[-windows - 1 :]
    angles = angle_means(time_s, angle_rad, *marks, edges, angle_step_rad, windows)
    orbit = signals.amplitude_means(edges, windows)
    if angles is None or orbit is None:
        missing = "pendulum angles" if angles is None else "displacements"
        return _unknown(f"too many samples of the {missing} are missing")
    held = release_time_s is not None and _still_as_released(
        time_s, angle_rad, angles.means[-1], edges[-1], release_time_s, limits.linger_s
    )
    return _judged(angles, orbit, limits, _speed_change(*marks, edges[-windows - 1 :]), held)


def _judged(angles: WindowMeans, orbit: WindowMeans, limits: SettlingLimits, speed: str, held: bool) -> Settling:
    """Return the decision for means of angles and amplitudes.

    Args:
        speed: reason against, from the rotor's speed; may be empty.
        held: True if the pendulums still have their gap at release.
    """
    slip = _slipping(angles.means[-limits.windows :])
    turning = _worst(angles, limits.angle_tolerance_rad, _MIN_WIDTH_ANGLE, limits.average_s)
    whirling = _worst(orbit, limits.amplitude_tolerance_m, _MIN_WIDTH_AMPLITUDE, limits.average_s)
    found = _settling(angles, orbit, turning, whirling)
    angle_limit = limits.slack * limits.angle_tolerance_rad
    amplitude_limit = limits.slack * _visible(orbit, limits.amplitude_tolerance_m)
    reasons = [
        speed,
        slip,
        "pendulums still stand as released; they may be on an unstable balance" if held else "",
        _reason("pendulum angles", found.drift_rad, turning, angle_limit, 180 / math.pi, "°"),
        _reason("amplitudes", found.drift_m, whirling, amplitude_limit, 1e6, " µm"),
    ]
    lasting = max(_more(turning, angle_limit), _more(whirling, amplitude_limit))
    bounded = math.isfinite(found.remaining_rad) and math.isfinite(found.remaining_m)
    found = replace(found, approaching=bounded and any(reasons[3:]) and not any(reasons[:3]))
    return _decision(found, reasons, "angles and amplitudes are steady", math.inf if slip else lasting, bool(slip))


def locked_settled(
    signals: RotorSignals, *, amplitude_tolerance_m: float = 5e-6, window_s: float = 1.0, windows: int = 9
) -> Settling:
    """Decide whether the locked orbit is steady, before the pendulums are released; limits as in `SettlingLimits`.

    The pendulum angles are not used.
    """
    edges = whole_revolutions(signals.mark_time_s, signals.mark_phase_rad, window_s, _MAX_WINDOWS)
    if len(edges) <= windows:
        return _unknown(f"fewer than {number_of(windows, 'window')} of {window_s:g} s at speed")
    orbit = signals.amplitude_means(edges, windows)
    if orbit is None:
        return _unknown("too many samples of the displacements are missing")
    whirling = _worst(orbit, amplitude_tolerance_m, _MIN_WIDTH_AMPLITUDE, window_s)
    limit = _visible(orbit, amplitude_tolerance_m)
    found = _settling(None, orbit, Approach(math.nan, math.nan, 0.0, 0.0), whirling)
    reasons = [
        _speed_change(signals.mark_time_s, signals.mark_phase_rad, edges[-windows - 1 :]),
        _reason("amplitudes", found.drift_m, whirling, limit, 1e6, " µm"),
    ]
    return _decision(found, reasons, "amplitudes are steady", _more(whirling, limit), slipping=False)


def _visible(orbit: WindowMeans, tolerance_m: float) -> float:
    """Return the amplitudes' tolerance, or the width of a mean if coloured noise makes the width larger.

    A change that wandering lasers cannot resolve is detected by the pendulum angles, which the orbit follows.
    """
    return max(tolerance_m, float(orbit.width.max())) if orbit.coloured else tolerance_m


def _unknown(why: str) -> Settling:
    return Settling(False, False, why, math.nan, math.inf, math.nan, math.inf, 0.0)


def _worst(seen: WindowMeans, tolerance: float, min_width: float, average_s: float) -> Approach:
    """Return the larger bound of the two quantities."""
    both = [
        bound(seen.edges_s, column, max(float(width), min_width * tolerance), average_s, _FAR * tolerance)
        for column, width in zip(seen.means.T, seen.width, strict=True)
    ]
    worst = max(both, key=lambda a: a.remaining)
    return replace(worst, mean_off=max(a.mean_off for a in both))


def _settling(angles: WindowMeans | None, orbit: WindowMeans, turning: Approach, whirling: Approach) -> Settling:
    """Return the figures of a decision, without the decision itself."""
    drift = math.nan if angles is None else float(np.abs(angles.means[-1] - angles.means[-2]).max())
    drift_m = float(np.abs(orbit.means[-1] - orbit.means[-2]).max())
    span = float(orbit.edges_s[-1, 1] - orbit.edges_s[0, 0])
    found = Settling(False, False, "", drift, turning.remaining, drift_m, whirling.remaining, span)
    return replace(found, mean_off_rad=turning.mean_off, mean_off_m=whirling.mean_off)


def _decision(found: Settling, reasons: list[str], steady: str, more_s: float, slipping: bool) -> Settling:
    """Complete the decision: with the first reason against, or with the statement that everything is steady."""
    why = next((reason for reason in reasons if reason), "")
    return replace(found, settled=not why, slipping=slipping, why=why or steady, more_s=more_s if why else 0.0)


def _more(approach: Approach, tolerance: float) -> float:
    """Return the time after which the remaining change of an approach is below the tolerance, s."""
    if approach.remaining <= tolerance:
        return 0.0
    rate = approach.rate_per_s
    return math.log(approach.remaining / tolerance) / rate if rate > 0 else math.inf


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


def _reason(what: str, drift: float, to_come: Approach, tolerance: float, factor: float, unit: str) -> str:
    """Return a sentence if the remaining change may exceed the tolerance, otherwise an empty text."""
    if math.isinf(to_come.remaining):
        return f"{what} drift by {drift * factor:.2g}{unit} per window and the drift does not shrink"
    if to_come.remaining > tolerance:
        more = _more(to_come, tolerance)
        return (
            f"{what} may still change by {to_come.remaining * factor:.2g}{unit}, the limit is "
            f"{tolerance * factor:.2g}{unit}" + (f"; about {math.ceil(more)} s more" if math.isfinite(more) else "")
        )
    return ""
