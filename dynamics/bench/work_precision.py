"""The whole benchmark of the dynamics: stages, their sizes, and the figures with their targets."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

from dynamics.bench import heyoka_runs
from dynamics.bench.fresh_process import PREDICT, WARM, process_rows
from dynamics.bench.motion_precision import motion_rows
from dynamics.bench.multiplier_precision import cases, multiplier_rows
from dynamics.bench.records import Measurement, Target, over_points
from dynamics.bench.throughput import batch_rows, map_rows, steady_state_rows
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.stability_map import stability_map
from rig_basics.texts import number_of

ALL_POINTS = "all points"
RELEASE, STIFF_RELEASE = "release", "release with c34 = 50, 2 s"
_STIFF_SCIPY = (("LSODA", 1e-6), ("LSODA", 1e-9), ("Radau", 1e-6))  # an explicit method takes ten seconds a run
_SPEED_RATIO = 1.6  # Ω of the releases


@dataclass(frozen=True)
class WorkPrecisionSize:
    """Extent of the benchmark.

    Attributes:
        points: names of the rig's points. None: all points.
        extremes: whether the stiff and the slow case are measured.
        map_shape: numbers of stiffness ratios and speed ratios.
        map_sample: number of points of the map compared with the reference.
        runs: number of releases in the batch.
        accuracies: requested from the services.
        tolerances: per step of the project's integrators.
        peer_tolerances: per step of heyoka.
        longest_s: step numbers are doubled while a call takes less than this time, s.
        repeats: number of timed samples of each call.
        scipy_settings: (method, tolerance) of scipy's integrators.
        processes: whether whole processes are started, with and without a compilation cache.
    """

    points: tuple[str, ...] | None
    extremes: bool
    map_shape: tuple[int, int]
    map_sample: int
    runs: int
    accuracies: tuple[float, ...]
    tolerances: tuple[float, ...]
    peer_tolerances: tuple[float, ...]
    longest_s: float
    repeats: int
    scipy_settings: tuple[tuple[str, float], ...]
    processes: bool


FULL = WorkPrecisionSize(
    points=None,
    extremes=True,
    map_shape=(250, 400),
    map_sample=200,
    runs=1000,
    accuracies=(1e-3, 1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-12),
    tolerances=(1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14),
    peer_tolerances=(1e-6, 1e-9, 1e-15),
    longest_s=0.15,
    repeats=7,
    scipy_settings=(("DOP853", 1e-6), ("DOP853", 1e-9), ("DOP853", 1e-12), ("LSODA", 1e-6), ("LSODA", 1e-9)),
    processes=True,
)
QUICK = WorkPrecisionSize(
    points=("A", "B"),
    extremes=False,
    map_shape=(15, 40),
    map_sample=40,
    runs=20,
    accuracies=(1e-6, 1e-9),
    tolerances=(1e-8, 1e-11),
    peer_tolerances=(1e-9,),
    longest_s=0.005,
    repeats=1,
    scipy_settings=(("DOP853", 1e-9),),
    processes=False,
)


def warm_up(parameters: RotorParameters) -> None:
    """Call each function that is compiled at its first call, so that compilation is not part of a stage."""
    rig = parameters, parameters.speed_rad_s(_SPEED_RATIO)
    multiplier_rows("", rig, (1e-8,), (), 0.0, 1)
    motion_rows("", rig, 0.1, (1e-6,), (1e-6,), (), (), 1)
    stability_map(parameters, np.array([_SPEED_RATIO]), np.array([2.0]))


def stages(
    parameters: RotorParameters, points: dict[str, float], size: WorkPrecisionSize
) -> dict[str, Callable[[], list[Measurement]]]:
    """Stages of a run in order, under the names shown to the user.

    Args:
        points: speed ratios by point name.
    """
    kept = {n: ratio for n, ratio in points.items() if size.points is None or n in size.points}
    multipliers = cases(parameters, kept, size.extremes)
    at_speed = (parameters, parameters.speed_rad_s(_SPEED_RATIO))
    stiff = parameters.with_values(c3_Nms_per_rad=50.0, c4_Nms_per_rad=50.0)

    def of_multipliers() -> list[Measurement]:
        rows: list[Measurement] = []
        for name, rig in multipliers.items():
            rows += multiplier_rows(name, rig, size.accuracies, size.peer_tolerances, size.longest_s, size.repeats)
        return rows + over_points(rows, ALL_POINTS, list(kept))

    def of_motion() -> list[Measurement]:
        settings = size.tolerances, size.accuracies, size.peer_tolerances
        rows = motion_rows(RELEASE, at_speed, 20.0, *settings, size.scipy_settings, size.repeats)
        if size.extremes:
            rows += motion_rows(STIFF_RELEASE, (stiff, at_speed[1]), 2.0, *settings, _STIFF_SCIPY, size.repeats)
        return rows

    found = {
        "multipliers": of_multipliers,
        "motion": of_motion,
        "map": lambda: map_rows(
            parameters, size.map_shape, size.map_sample, 1e-8, size.peer_tolerances[-1], min(3, size.repeats)
        ),
        "batch": lambda: batch_rows(parameters, _SPEED_RATIO, size.runs, 20.0),
        "steady states": lambda: steady_state_rows({n: multipliers[n] for n in kept}, 1e-8, size.repeats),
    }
    if size.processes:
        found["processes"] = lambda: process_rows(heyoka_runs.available(), 3)
    return found


def targets(rows: Iterable[Measurement]) -> list[Target]:
    """Measured figures with their targets."""
    rows, found = list(rows), list[Target]()
    for row in rows:
        if row.peer:
            continue
        if row.service == "map" and row.count == math.prod(FULL.map_shape):
            found.append(Target("map, µs a point", 20.0, 1e6 * row.seconds))
        if row.service == "map" and row.true_error is not None:
            found.append(Target("map, true error of the sample", 1e-8, row.true_error))
        if row.service == "batch" and row.count == FULL.runs:
            found.append(Target(f"{number_of(FULL.runs, 'release')} of 20 s, s", 1.5, FULL.runs * row.seconds))
        if row.service == "process" and row.case == PREDICT:
            warm = row.setting == WARM
            found.append(Target(f"predict, {'warm' if warm else 'cold'}, s", 1.5 if warm else 15.0, row.seconds))
    exact = [
        r.seconds
        for r in rows
        if (r.service, r.case) == ("motion", RELEASE)
        and not r.peer
        and not r.automatic
        and r.true_error is not None
        and r.true_error <= 1e-9
    ]
    if exact:
        found.append(Target("20 s release to 1e-9 rad, ms", 5.0, 1e3 * min(exact)))
    service = [r for r in rows if r.case == RELEASE and r.automatic and r.accuracy == 1e-9]
    if service:
        found.append(Target("20 s release by simulate(accuracy=1e-9), ms", 12.5, 1e3 * service[0].seconds))
    return found


def machine() -> dict[str, Any]:
    """Machine and versions of the run."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:  # usual: only Linux has this file
        pass
    return platform.processor() or platform.machine()
