"""Clock errors in a test's estimate. Signals with the same clock have the same error.

Each device of a rig has its own clock. All signals of an imported recording have the clock of its recorder, and all
recordings of that recorder share it. A label identifies one clock: errors with the same label are fully correlated.
The error of a clock's rate has two parts. One comes from the clock's tolerance and is the same in every record of the
clock. The other comes from the read times of the record and belongs to this record alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.signals.clock_rates import clock_of, clock_rate_std
from daq.signals.run import Run
from identification.sources import log_names
from rig_configs.error_label import ErrorLabel


def clock_label(clock: str) -> ErrorLabel:
    """Label of the rate error of a clock, by the clock's name."""
    return ErrorLabel("clock", clock)


def read_label(clock: str, sources: Sequence[str]) -> ErrorLabel:
    """Label of the part of a clock's rate error that comes from the read times of one log.

    Args:
        clock: name of the clock.
        sources: logs that were fitted together, usually one.
    """
    return ErrorLabel("clock", clock, log_names(sources))


def clock_errors(
    run: Run, slopes: Mapping[str, NDArray[np.float64]], sources: Sequence[str] = ()
) -> dict[ErrorLabel, NDArray[np.float64]]:
    """Shared errors of an estimate that come from clock rates.

    Args:
        run: run with the clocks.
        slopes: signal ("x", "y", "angles", "phase") → change of the estimate's values per relative change of the rate
            of its clock, shape (n,).
        sources: logs that were fitted together; by default the run's own.
    Returns:
        Label → shift of the values for one standard deviation of the error, shape (n,). The label is "clock NAME" for
        the part that all runs share and "clock NAME in LOG" for the part of this run.
    """
    shared: dict[ErrorLabel, NDArray[np.float64]] = {}
    for signal, slope in slopes.items():
        clock, std, alike = clock_of(run, signal), clock_rate_std(run.clock_rate_std, signal), _alike(run, signal)
        own = math.sqrt(max(std**2 - alike**2, 0.0))
        for label, size in ((clock_label(clock), alike), (read_label(clock, sources or (run.source,)), own)):
            if size > 0 or label == clock_label(clock):
                shared[label] = shared.get(label, 0.0) + slope * size
    return shared


def joined_rates(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """Largest clock uncertainties of several runs, as fields of the run that represents all of them."""
    signals = ("x", "y", "angles", "phase")
    return {
        "clock_rate_std": {d: max(clock_rate_std(r.clock_rate_std, d) for r in runs) for d in signals},
        "clock_shared_std": {d: max(_alike(r, d) for r in runs) for d in signals},
    }


def _alike(run: Run, signal: str) -> float:
    """Part of the standard uncertainty of a clock's rate that all runs of that clock share."""
    return float(run.clock_shared_std.get(signal, clock_rate_std(run.clock_rate_std, signal)))
