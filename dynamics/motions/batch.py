"""Many motions at once, on all cores.

A run is compiled code that holds no lock of the interpreter, so plain threads keep every core busy and each run keeps
what a single one has: its own method, steps, error bound, friction, and refusal in words.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynamics.equations.scene import Scene
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.motions.integrate import WORK_LIMIT, simulate
from dynamics.motions.motion_problem import instants


@dataclass(frozen=True)
class BatchMotion:
    """Motions of many runs at the same instants.

    Attributes:
        time_s: shape (n,).
        states: shape (runs, n, 8) in SI, or (runs, 1, 8) when only the last was asked; NaN for a run that failed.
        error_estimates: bound of each run (Motion.error_estimate), shape (runs,); inf for one that failed.
        failures: why each run failed, None for one that did not.
    """

    time_s: np.ndarray
    states: np.ndarray
    error_estimates: np.ndarray
    failures: tuple[str | None, ...]

    @property
    def ok(self) -> np.ndarray:
        """Which runs succeeded, shape (runs,)."""
        return np.array([f is None for f in self.failures], dtype=bool)


def simulate_batch(
    parameters: Sequence[object],
    scenes: Scene | Sequence[Scene],
    time_s: np.ndarray | float,
    accuracy: float = 1e-6,
    progress: Callable[[int, int], None] | None = None,
    *,
    last_only: bool = False,
    work_limit: int = WORK_LIMIT,
) -> BatchMotion:
    """The motions of many runs.

    Args:
        parameters: one set (or rig) per run.
        scenes: one per run, or one for all.
        time_s, accuracy: as for dynamics.motions.integrate.simulate.
        progress: called with (runs done, all runs) about a hundred times.
        last_only: keep only each run's last state.
        work_limit: steps each run may take.
    Raises:
        OutsideDomain: counts that do not match, or what is wrong with the instants. What is wrong with one run is in
            its `failures`.
    """
    times = instants(time_s)
    each = [scenes] * len(parameters) if isinstance(scenes, Scene) else list(scenes)
    if len(each) != len(parameters):
        raise OutsideDomain(f"{len(parameters)} parameter sets need one scene or as many, got {len(each)}")
    count = len(parameters)
    states = np.full((count, 1 if last_only else len(times), 8), np.nan)
    bounds = np.full(count, np.inf)
    failures: list[str | None] = [None] * count

    def one(i: int) -> str | None:
        try:
            motion = simulate(parameters[i], each[i], times, accuracy, work_limit=work_limit)
        except DynamicsError as error:
            return str(error)
        states[i] = motion.state[-1:] if last_only else motion.state
        bounds[i] = motion.error_estimate
        return None

    every = max(1, count // 100)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for i, failure in enumerate(pool.map(one, range(count))):
            failures[i] = failure
            if progress is not None and ((i + 1) % every == 0 or i + 1 == count):
                progress(i + 1, count)
    return BatchMotion(times, states, bounds, tuple(failures))
