"""Measured costs and gains of the estimators' settings: one table for help texts and docs/benchmarks.md.

The figures are the rows of one run of the commands named here. A test compares docs/benchmarks.md with them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Span = tuple[float, float]


@dataclass(frozen=True)
class SettingCost:
    """One setting of one estimator relative to the balanced setting on the same cases.

    Attributes:
        service, setting: what was measured.
        time: time over balanced's, median over the cases.
        error: rms error over balanced's: least and largest of the cases.
        cases, records: number of cases, and the least number of records in any.
    """

    service: str
    setting: str
    time: float
    error: Span
    cases: int
    records: int


COMMAND = "rig bench identification --quick"
TRACKING_COMMAND = "python -m benchmarks.tracking_settings LOG"
MACHINE = "AMD EPYC, two shared cores with other work on both, Python 3.11, numba 0.68, 23 November 2026"
COSTS = (
    SettingCost("ring-down", "fast", 0.94, (0.99, 1.01), 4, 15),
    SettingCost("ring-down", "reference", 3.6, (0.98, 1.02), 4, 15),
    SettingCost("two axes", "fast", 0.84, (0.98, 0.98), 1, 6),
    SettingCost("two axes", "reference", 3.8, (0.76, 0.76), 1, 4),
    SettingCost("run-up", "fast", 1.2, (0.96, 0.96), 1, 6),
    SettingCost("run-up", "reference", 9.1, (1.05, 1.05), 1, 4),
    SettingCost("spin-down", "fast", 0.036, (1.4, 1.5), 2, 15),
    SettingCost("spin-down", "reference", 65.0, (0.4, 0.84), 2, 3),
    SettingCost("release", "fast", 0.48, (1.01, 1.01), 1, 3),
    SettingCost("release", "reference", 1.7, (1.01, 1.01), 1, 3),
)
"""With fewer than ten records the errors of a setting do not differ significantly from balanced's."""


def _span(setting: str, low: Callable[[SettingCost], float], high: Callable[[SettingCost], float]) -> str:
    chosen = [cost for cost in COSTS if cost.setting == setting]
    return f"{min(map(low, chosen)):.2g} to {max(map(high, chosen)):.2g}"


def _line(setting: str) -> str:
    times = _span(setting, lambda c: c.time, lambda c: c.time)
    errors = _span(setting, lambda c: c.error[0], lambda c: c.error[1])
    return f"{setting} takes {times} times the time of balanced with {errors} times its errors"


SETTING_HELP = (
    "cheapest with honest intervals, near the bound, or as exact as the data allow; by test, "
    f"{_line('fast')}, {_line('reference')} ({COMMAND}, few records: docs/benchmarks.md)"
)
"""Help of `--setting` for tests that fit records."""


@dataclass(frozen=True)
class TrackingCost:
    """Both settings of tracking on one log.

    Attributes:
        log: what was recorded.
        fast_ms: processor time of the fast setting per second of record, ms.
        ratio: time of the reference over it.
        rates, damping: standard deviation smoothed over filtered, median over the rows: of the rates, of ln c.
    """

    log: str
    fast_ms: float
    ratio: float
    rates: float
    damping: float


TRACKING = TrackingCost("a spin-down of 2.2 s on the virtual rig", 8.0, 69.0, 0.58, 0.63)
TRACKING_HELP = (
    f"fast: the compiled filter, {TRACKING.fast_ms:.0f} ms a second of record; reference: the same filtered states by "
    f"filterpy in {TRACKING.ratio:.0f} times the time, and smoothed ones whose std is {TRACKING.rates:.2g} (rates) and "
    f"{TRACKING.damping:.2g} (ln c) of the filter's (docs/benchmarks.md)"
)
"""Help of `rig track --setting`."""

WITHOUT_HELP = (
    "a rung of the model ladders that is never taken, even if the data support it; repeat for more: lines, "
    "spectrum, wander, amplitude, second-mode, slow-roll, ripple, clocks, friction, drag, open-masses "
    "(docs/how-to/experimenter/exclude_an_effect.md)"
)
"""Help of `rig identify --without`."""
