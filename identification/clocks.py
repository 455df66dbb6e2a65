# pyright: strict
"""Clocks' errors in a test's estimate: what shares a clock shares its error.

A rig's devices have a clock each. A recording made elsewhere has its recorder's clock for all that is in it, and a
recorder's recordings share it. A label stands for one clock, so errors under one label are taken as fully correlated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.signals.run import Run

_UNKNOWN = 20e-6


def clock_rate_std(rates: Mapping[str, float], signal: str) -> float:
    """Relative standard uncertainty of the rate of a signal's clock; 20 ppm when the run does not say."""
    return float(rates.get(signal, _UNKNOWN))


def clock_of(run: Run, signal: str) -> str:
    """Which clock stamped a signal: its device's, or the recorder's."""
    return run.clocks.get(signal, signal)


def clock_label(clock: str) -> str:
    """Under which errors of a clock's rate are kept, by the clock's name."""
    return f"clock {clock}"


def clock_errors(run: Run, slopes: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Shared errors of an estimate, by clock.

    Args:
        run: whose clocks they are.
        slopes: signal ("x", "y", "angles", "phase") → change of the estimate's values per relative change of the rate
            of its clock, shape (n,).
    Returns:
        "clock NAME" → the values' shift for one standard deviation of that clock's rate, shape (n,).
    """
    shared: dict[str, NDArray[np.float64]] = {}
    for signal, slope in slopes.items():
        label = clock_label(clock_of(run, signal))
        shift = slope * clock_rate_std(run.clock_rate_std, signal)
        shared[label] = shared[label] + shift if label in shared else shift
    return shared


def rate_std_between(run: Run, signal: str, other: str) -> float:
    """Relative standard uncertainty of one signal's clock against another's; 0 where one clock stamped both."""
    if clock_of(run, signal) == clock_of(run, other):
        return 0.0
    rates = run.clock_rate_std
    return math.hypot(clock_rate_std(rates, signal), clock_rate_std(rates, other))
