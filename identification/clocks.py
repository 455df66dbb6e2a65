# pyright: strict
"""Clocks' errors in a test's estimate: what shares a clock shares its error.

A rig's devices have a clock each. A recording made elsewhere has its recorder's clock for all that is in it, and a
recorder's recordings share it. A label stands for one clock, so errors under one label are taken as fully correlated.
A clock's rate comes from its tolerance as far as a record does not show it, which every record of the clock has alike,
and from when the record's reads came, which only this record has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.signals.clock_rates import clock_of, clock_rate_std
from daq.signals.run import Run


def clock_label(clock: str) -> str:
    """Under which errors of a clock's rate are kept, by the clock's name."""
    return f"clock {clock}"


def read_label(clock: str, source: str) -> str:
    """Under which the part of a rate's error is kept that one log has, having read the rate itself.

    Args:
        source: the log's path, or several with " + " between.
    """
    return f"{clock_label(clock)} in {' + '.join(Path(each).name for each in source.split(' + '))}"


def clock_errors(run: Run, slopes: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Shared errors of an estimate, by clock.

    Args:
        run: whose clocks they are.
        slopes: signal ("x", "y", "angles", "phase") → change of the estimate's values per relative change of the rate
            of its clock, shape (n,).
    Returns:
        "clock NAME", and "clock NAME in LOG" for what only this run is off by → the values' shift for one standard
        deviation of that error, shape (n,).
    """
    shared: dict[str, NDArray[np.float64]] = {}
    for signal, slope in slopes.items():
        clock, std, alike = clock_of(run, signal), clock_rate_std(run.clock_rate_std, signal), _alike(run, signal)
        own = math.sqrt(max(std**2 - alike**2, 0.0))
        for label, size in ((clock_label(clock), alike), (read_label(clock, run.source), own)):
            if size > 0 or label == clock_label(clock):
                shared[label] = shared.get(label, 0.0) + slope * size
    return shared


def joined_rates(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """The least certain clocks of some runs, as fields of the run that stands for all of them."""
    signals = ("x", "y", "angles", "phase")
    return {
        "clock_rate_std": {d: max(clock_rate_std(r.clock_rate_std, d) for r in runs) for d in signals},
        "clock_shared_std": {d: max(_alike(r, d) for r in runs) for d in signals},
    }


def _alike(run: Run, signal: str) -> float:
    """What of the standard uncertainty of a clock's rate all runs of that clock share."""
    return float(run.clock_shared_std.get(signal, clock_rate_std(run.clock_rate_std, signal)))
