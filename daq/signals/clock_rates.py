"""Clock that stamped a run's signal, and the uncertainty of its rate."""

from __future__ import annotations

import math
from collections.abc import Mapping

from daq.signals.run import Run

_DEFAULT_RATE_STD = 20e-6


def clock_rate_std(rates: Mapping[str, float], signal: str) -> float:
    """Relative standard uncertainty of the rate of a signal's clock; 20 ppm if the run does not state it."""
    return float(rates.get(signal, _DEFAULT_RATE_STD))


def clock_of(run: Run, signal: str) -> str:
    """Return the name of the clock that stamped a signal: that of its device, or the recorder's."""
    return run.clocks.get(signal, signal)


def rate_std_between(run: Run, signal: str, other: str) -> float:
    """Relative standard uncertainty of one signal's clock against another's; 0 if one clock stamped both."""
    if clock_of(run, signal) == clock_of(run, other):
        return 0.0
    rates = run.clock_rate_std
    return math.hypot(clock_rate_std(rates, signal), clock_rate_std(rates, other))
