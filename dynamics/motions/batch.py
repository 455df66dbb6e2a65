"""Many motions at once, on all cores.

Compiled code releases the interpreter lock, so threads use every core. Each run has the properties of a single
`simulate` call: its own method, steps, error bound, friction and error message.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynamics.arrays import Array, Flags
from dynamics.equations.parameters import RigOrParameters
from dynamics.equations.scene import Scene
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.motions.integrate import WORK_LIMIT, simulate
from dynamics.motions.motion import COMPONENTS
from dynamics.motions.motion_problem import instants
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool


@dataclass(frozen=True)
class BatchMotion(Tabular):
    """Motions of many runs at the same instants.

    Attributes:
        time_s: shape (n,).
        states: shape (runs, n, 8) in SI, or (runs, 1, 8) with `last_only`. NaN for a failed run.
        error_estimates: error bound of each run (Motion.error_estimate), shape (runs,); inf for a failed run.
        failures: error message of each run, or None for a successful one.
    """

    time_s: Array
    states: Array
    error_estimates: Array
    failures: tuple[str | None, ...]

    @property
    def ok(self) -> Flags:
        """Which runs succeeded, shape (runs,)."""
        return np.array([f is None for f in self.failures], dtype=bool)

    @property
    def heading(self) -> str:
        """Number of runs."""
        return f"BatchMotion: {number_of(len(self.failures), 'run')}, {np.count_nonzero(self.ok)} succeeded"

    @property
    def remarks(self) -> Sequence[str]:
        """The error messages."""
        return [f"run {run}: {failure}" for run, failure in enumerate(self.failures) if failure is not None]

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each instant of each run."""
        runs, kept = len(self.failures), self.states.shape[1]
        times = np.tile(self.time_s[len(self.time_s) - kept :], runs)
        states = self.states.reshape(-1, len(COMPONENTS)).T
        return {"run": np.repeat(np.arange(runs), kept), "time_s": times, **dict(zip(COMPONENTS, states, strict=True))}


def simulate_batch(
    parameters: Sequence[RigOrParameters],
    scenes: Scene | Sequence[Scene],
    time_s: ArrayLike,
    accuracy: float = 1e-6,
    progress: Callable[[int, int], None] | None = None,
    *,
    last_only: bool = False,
    work_limit: int = WORK_LIMIT,
) -> BatchMotion:
    """Simulate many runs.

    Args:
        parameters: one set (or rig) per run.
        scenes: one per run, or one for all.
        time_s, accuracy: as for dynamics.motions.integrate.simulate.
        progress: called about a hundred times with (number of finished runs, number of all runs).
        last_only: keep only the last state of each run.
        work_limit: largest number of steps per run.
    Raises:
        OutsideDomain: the counts do not match, or the instants are invalid. Errors of single runs are stored in
            `failures`.
    """
    times = instants(time_s)
    each = [scenes] * len(parameters) if isinstance(scenes, Scene) else list(scenes)
    if len(each) != len(parameters):
        raise OutsideDomain(
            f"{number_of(len(parameters), 'parameter set needs', 'parameter sets need')} one scene or as "
            f"many, got {len(each)}"
        )
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
    with ThreadPool(os.cpu_count() or 1) as pool:
        for i, failure in enumerate(pool.map(one, range(count))):
            failures[i] = failure
            if progress is not None and ((i + 1) % every == 0 or i + 1 == count):
                progress(i + 1, count)
    return BatchMotion(times, states, bounds, tuple(failures))
