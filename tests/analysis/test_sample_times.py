"""Times that no evaluation can use are refused with a sentence by every function that takes arrays of samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analysis import (
    amplitude_spectrum,
    full_spectrum,
    order_map,
    order_track,
    phase_at,
    power_density,
    resampled_order_track,
    slip_track,
    speed_at,
)
from daq import Run

TIME = np.arange(0.0, 4.0, 1e-3)
PHASE = 2 * np.pi * 10 * TIME
SIGNAL = np.cos(PHASE)
EMPTY = np.empty(0)
RUN = Run("run-up", "", 0.0, TIME, SIGNAL, TIME, SIGNAL, EMPTY, np.empty((0, 2)), TIME[::100], PHASE[::100])
AT: dict[str, Callable[[Any], object]] = {
    "phase": lambda time: phase_at(RUN, time),
    "speed": lambda time: speed_at(RUN, time),
}
EVALUATED: dict[str, Callable[[Any], object]] = {
    "order track": lambda time: order_track(time, SIGNAL, PHASE),
    "order track in windows": lambda time: order_track(time, SIGNAL, PHASE, revolutions=4),
    "order map": lambda time: order_map(time, SIGNAL, PHASE),
    "resampled order track": lambda time: resampled_order_track(time, SIGNAL, PHASE),
    "density": lambda time: power_density(time, SIGNAL),
    "amplitude spectrum": lambda time: amplitude_spectrum(time, SIGNAL),
    "full spectrum": lambda time: full_spectrum(time, SIGNAL, SIGNAL),
    "slip": lambda time: slip_track(time, PHASE, PHASE),
}


@pytest.mark.parametrize("name", [*AT, *EVALUATED])
def test_dates_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"got an array of datetime64\[ns\]; convert dates"):
        (AT | EVALUATED)[name]((1e9 * TIME).astype("datetime64[ns]"))


@pytest.mark.parametrize("name", EVALUATED)
def test_times_that_run_backwards_are_refused(name: str) -> None:
    swapped = TIME.copy()
    swapped[[100, 101]] = TIME[[101, 100]]
    with pytest.raises(ValueError, match=r"runs backwards after sample 100 \(0\.101 s\)"):
        EVALUATED[name](swapped)
