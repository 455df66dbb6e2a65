"""Comparison of the speed that a drive reports with the speed of the rotor's index marks.

A drive computes its speed from its own settings (pole pairs, gear, unit), so a wrong setting scales command and report
alike. The index marks count the rotor's own turns. The turns counted at the marks are a straight function of the
turns by the reports, N(t) = ∫n dt, and of the delay τ of the reports: turns = ρ N(t) + ρ τ n(t) + constant. The ratio
ρ, τ and the constant follow by least squares, τ with a prior of standard deviation `REPORT_DELAY_S`. A ramp therefore
needs no window of constant speed. The times of the marks may drift against those of the reports, evenly and with the
square of the time, by `_DRIFT_S` each: on a ramp only the curvature of N(t) separates ρ from τ, and 3 ms of drift in
3 s would count as 2.7 % of ρ.

The uncertainty of ρ contains the errors of the marks in time, by the residuals if they are larger than stated, the
delay, and one step of the reports, which may be truncated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array

SPEED_TOLERANCE = (0.01, 2.0)
"""Deviation from a requested speed that counts as reached: share, and additional rpm (two steps of a report)."""
REPORT_DELAY_S = 0.1
"""Delay of a speed report by the drive's filter, the bus and the host, s."""
_STEP_RPM = 1.0  # reports of CiA 402 in velocity mode are whole rpm; truncation and rounding are not distinguished
# Standard uncertainty of one mark on the common clock, from the clock map and the index sensor.
_MARK_STD_S = 1e-3
_DRIFT_S, _DRIFTING_S = 5e-3, 3.0  # of a clock's map on a busy host, s, and its first seconds in which it drifts
_STDS = 3.0  # coverage of the ratio's uncertainty
_MIN_TURNS = 5
_MIN_RPM_STEPS = 10.0  # at lower speeds the steps of the reports exceed a tenth of the speed
_MAX_SLIP = 0.005  # deviation from a ratio of settings, by slip of belt or field, that still points to the ratio
_MAX_SUM, _MAX_PAIRS = 12, 14
"""Ratios that are named: of two numbers with at most this sum, and of two successive numbers of pole pairs.

A ratio at random lies within `_MAX_SLIP` of one of the former with a probability of about 0.1. Two neighbours of the
latter are 1/n² apart, which exceeds `_MAX_SLIP` up to 14 pole pairs.
"""
_RATIOS = tuple(
    (true, total - true)
    for total in range(3, 2 * _MAX_PAIRS)
    for true in range(1, total)
    if math.gcd(true, total) == 1 and (total <= _MAX_SUM or abs(total - 2 * true) == 1)
)
_UNITS = (
    (60.0, "revolutions per second taken for rpm"),
    (30.0 / math.pi, "rad/s taken for rpm"),
    (2.0 * math.pi, "rad/s taken for revolutions per second"),
    (10.0, "steps of 0.1 rpm, or a decimal place"),
    (100.0, "steps of 0.01 rpm, or two decimal places"),
    (1000.0, "milli-rpm taken for rpm"),
)


@dataclass(frozen=True)
class SpeedAgreement:
    """Mean speeds over one interval.

    Attributes:
        marks_rpm: mean by the index marks.
        drive_rpm: mean by the drive's reports, which may be late.
        ratio: speed by the marks over the speed by the reports.
        ratio_std: its standard uncertainty.
    """

    marks_rpm: float
    drive_rpm: float
    ratio: float
    ratio_std: float

    @property
    def limit(self) -> float:
        """Largest deviation of the ratio from 1 that is no disagreement."""
        share, more = SPEED_TOLERANCE
        return share + more / self.marks_rpm + _STDS * self.ratio_std

    @property
    def agrees(self) -> bool:
        """Whether both speeds agree within the tolerance of a requested speed and the ratio's uncertainty."""
        return abs(self.ratio - 1.0) <= self.limit

    @property
    def words(self) -> str:
        """The disagreement with its likely cause; empty if both agree."""
        if self.agrees:
            return ""
        return (
            f"the index marks come at {self.marks_rpm:.0f} rpm, the drive reports {self.drive_rpm:.0f} rpm: "
            f"{self.ratio_words}"
        )

    @property
    def ratio_words(self) -> str:
        """The ratio with its uncertainty and its likely cause."""
        cause = likely_cause(self.ratio, self.ratio_std)
        return f"the ratio is {self.ratio:.4g} ± {_STDS * self.ratio_std:.2g}, {cause}"


def likely_cause(ratio: float, ratio_std: float) -> str:
    """Return the likely cause of a ratio of the true to the reported speed, with what to look at.

    A unit comes first, then the nearest ratio of small whole numbers within the uncertainty and `_MAX_SLIP`.
    """
    width = _MAX_SLIP + _STDS * ratio_std / ratio
    for factor, unit in _UNITS:
        if min(abs(ratio / factor - 1.0), abs(ratio * factor - 1.0)) <= width:
            return f"likely a unit ({unit}). Look at the unit of the drive's speed and the scale in the rig file"
    true, reported = min(_RATIOS, key=lambda pair: abs(ratio * pair[1] / pair[0] - 1.0))
    if abs(ratio * reported / true - 1.0) > width:
        return "no simple ratio. Look at slip and load, and at the drive's number of pole pairs, gear and unit"
    return (
        f"likely {true}:{reported}. Look at the drive's number of pole pairs ({true} n set where the motor has "
        f"{reported} n) and at the gear, in the drive's settings and in the rig file"
    )


def speed_agreement(
    mark_time_s: Array, turns: NDArray[np.floating | np.integer], report_time_s: Array, report_rpm: Array
) -> SpeedAgreement | None:
    """Compare index marks with a drive's reports.

    Args:
        mark_time_s, turns: times of the marks, ascending, and revolutions counted at each, shape (n,).
        report_time_s, report_rpm: times of the reports on the same clock, ascending, and speeds, rpm, shape (m,); NaN
            for a report without a speed.

    Returns:
        Means between the first and the last mark that lie within the reports; None if they cannot be compared: fewer
        than `_MIN_TURNS` revolutions, a gap, or a speed that is not resolved by the reports' steps.
    """
    if len(report_time_s) < 2 or not np.all(np.isfinite(report_rpm)):
        return None
    inside = (mark_time_s >= report_time_s[0]) & (mark_time_s <= report_time_s[-1])
    times, counted = np.asarray(mark_time_s[inside], np.float64), np.asarray(turns[inside], np.float64)
    if len(times) < 2 or np.any(np.diff(times) <= 0) or np.any(np.diff(counted) <= 0):
        return None
    span_s, turned = float(times[-1] - times[0]), float(counted[-1] - counted[0])
    if turned < _MIN_TURNS:
        return None
    within = (report_time_s > times[0]) & (report_time_s < times[-1])
    grid: Array = np.unique(np.concatenate([report_time_s[within], times]))
    per_s = np.abs(np.interp(grid, report_time_s, report_rpm)) / 60.0
    by_reports = np.r_[0.0, np.cumsum(0.5 * (per_s[1:] + per_s[:-1]) * np.diff(grid))]
    at_marks = np.searchsorted(grid, times)
    mean_rpm, marks_rpm = 60.0 * float(by_reports[-1]) / span_s, 60.0 * turned / span_s
    if min(mean_rpm, marks_rpm) < _MIN_RPM_STEPS * _STEP_RPM:
        return None
    place = 2.0 * (times - times[0]) / span_s - 1.0
    true_per_s = per_s[at_marks] * turned / by_reports[-1]
    drift_s = _DRIFT_S * min(1.0, span_s / _DRIFTING_S)
    ratio, std = _fitted_ratio(counted - counted[0], by_reports[at_marks], true_per_s, place, drift_s)
    return SpeedAgreement(marks_rpm, mean_rpm, ratio, math.hypot(std, ratio * 0.5 * _STEP_RPM / mean_rpm))


def _fitted_ratio(counted: Array, by_reports: Array, per_s: Array, place: Array, drift_s: float) -> tuple[float, float]:
    """Return ratio and standard uncertainty from the turns at the marks; all arrays of shape (n,), n ≥ 2.

    Args:
        counted, by_reports: turns by the marks and by the reports.
        per_s: speed at each mark, turns per second.
        place: time of each mark, from −1 at the first to 1 at the last.
        drift_s: standard deviation of the even and of the quadratic drift of their times, s.
    """
    std_turns = _MARK_STD_S * float(np.max(per_s))
    shifts = [per_s, per_s * place, per_s * place**2]
    rows = np.column_stack([by_reports, *shifts, np.ones(len(counted))]) / std_turns
    prior = np.diag([0.0, 1.0 / REPORT_DELAY_S, 1.0 / drift_s, 1.0 / drift_s, 0.0])[1:4]
    design, wanted = np.vstack([rows, prior]), np.r_[counted / std_turns, np.zeros(3)]
    inverse: Array = np.asarray(np.linalg.pinv(design), np.float64)
    found = inverse @ wanted
    excess = float(np.sum((design @ found - wanted) ** 2)) / max(1, len(counted) - 2)
    return float(found[0]), math.sqrt(max(1.0, excess) * float(inverse[0] @ inverse[0]))
