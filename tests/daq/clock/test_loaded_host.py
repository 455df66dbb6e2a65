"""Rate of a device clock from the reads of a loaded host: intervals hold, also if the load grows or falls in a record.

The simulation is written for these tests: a device counts its samples, a line passes them on, and a host reads late.
Its delays have a lower bound, are late on one side only, and their distribution changes with the load.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.clock import ClockLine, fit_line

Array = NDArray[np.float64]
Delays = Callable[[np.random.Generator, Array, Array], Array]
RATE_HZ, READ_S, TOLERANCE_PPM = 4000.0, 0.01, 30.0


def crowded(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """Every read waits for other processes, the longer the more of them run."""
    return rng.exponential(5e-5 + 5e-3 * load)


def two_waits(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """Every read waits twice: a read without delay is rarer still."""
    return rng.exponential(5e-5 + 2e-3 * load) + rng.exponential(5e-5 + 2e-3 * load)


def interpreter(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """Another thread holds the interpreter for up to 5 ms in a part of the reads."""
    held = rng.uniform(size=len(true_s)) < 0.1 + 0.85 * load
    return rng.exponential(3e-5, len(true_s)) + held * rng.uniform(0, 5e-3, len(true_s))


def stalls(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """The host stands still for some 30 ms at a time; what waited is read at once."""
    delay = rng.exponential(8e-5, len(true_s))
    at = 0.0
    while at < true_s[-1]:
        at += rng.exponential(0.05 / (0.02 + np.interp(at, true_s, load)))
        end = at + rng.exponential(0.03)
        within = (true_s >= at) & (true_s < end)
        delay[within] = np.maximum(delay[within], end - true_s[within])
    return delay


def three_waits(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """Every read waits three times, for an application, a driver and a scheduler."""
    return rng.gamma(3.0, 3e-5 + 2e-3 * load)


def ticks(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """A late host that wakes up at whole milliseconds only."""
    return _at_frames(true_s + rng.exponential(5e-5 + 3e-3 * load)) - true_s


def frames(rng: np.random.Generator, true_s: Array, load: Array) -> Array:
    """A USB converter sends once a millisecond; an incomplete packet waits for up to 16 ms."""
    waits = (rng.uniform(size=len(true_s)) < load) * rng.uniform(0, 16e-3, len(true_s))
    return _at_frames(true_s) + waits + rng.exponential(3e-5, len(true_s)) - true_s


def _at_frames(at_s: Array) -> Array:
    return np.ceil(at_s / 1e-3) * 1e-3


LAWS = {"crowded": crowded, "two waits": two_waits, "interpreter": interpreter, "stalls": stalls}
OTHER_LAWS = {"three waits": three_waits, "ticks": ticks, "frames": frames}
LOADS: dict[str, Callable[[Array], Array]] = {
    "idle": np.zeros_like,
    "steady": lambda share: np.full_like(share, 0.5),
    "grows": lambda share: share,
    "falls": lambda share: 1 - share,
    "begins late": lambda share: (share > 0.6).astype(np.float64),
}


def line_of(rng: np.random.Generator, seconds: float, drift: float, delays: Delays, load: str) -> ClockLine:
    """The line of a record."""
    true_s = np.cumsum(rng.uniform(0.6, 1.4, int(seconds / READ_S)) * READ_S)
    device_s = np.floor(true_s * RATE_HZ * (1 + drift)) / RATE_HZ
    late_s = delays(rng, true_s, LOADS[load](true_s / true_s[-1]))
    return fit_line(device_s, np.maximum.accumulate(true_s + 3e-4 + late_s), TOLERANCE_PPM, 1 / RATE_HZ)


CASES = [(seconds, law, load) for seconds in (12.0, 40.0) for law in LAWS for load in LOADS]
CASES += [(12.0, law, load) for law in OTHER_LAWS for load in ("idle", "falls", "begins late")]
CASES += [(40.0, "three waits", "grows"), (40.0, "frames", "begins late")]


@pytest.mark.parametrize(("seconds", "law", "load"), CASES)
def test_the_interval_of_a_rate_holds_for_any_course_of_the_load(seconds: float, law: str, load: str) -> None:
    z = list[float]()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        drift = 1e-6 * TOLERANCE_PPM * rng.standard_normal()
        line = line_of(rng, seconds, drift, (LAWS | OTHER_LAWS)[law], load)
        z.append((line.rate - (1 / (1 + drift) - 1)) / line.rate_std)
    assert np.mean(np.abs(z) < 2) >= 0.95
    assert abs(np.mean(z)) < 1


@pytest.mark.parametrize(
    ("law", "seconds", "ppm"), [("stalls", 12.0, 16.0), ("stalls", 40.0, 2.0), ("crowded", 40.0, 7.0)]
)
def test_a_loaded_host_does_not_pull_the_rate_towards_the_data_sheet(law: str, seconds: float, ppm: float) -> None:
    """A clock that is off by three times its tolerance, and a load that grows: frequencies would all be wrong alike.

    Reads in step with the samples are not excluded: in 12 s a step of one sample period turns the line by up to 31 ppm.
    """
    off = list[float]()
    for seed in range(40):
        line = line_of(np.random.default_rng(seed), seconds, 90e-6, LAWS[law], "grows")
        off.append(line.rate - (1 / (1 + 90e-6) - 1))
    assert abs(np.mean(off)) < 1e-6 * ppm
