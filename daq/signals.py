"""One run's signals on one clock: what identification and analysis work on.

Every device stamps its samples with its own clock. `load_run` fits one straight line per device over the whole log
(device time → host time, see daq.clock) and gives every signal in seconds since the run's start on the common
clock, with the uncertainty of each device's clock rate. Gaps stay gaps: nothing is filled in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Release:
    """A pendulum let go during the run: 0 is A, 1 is B; time in s since the run's start."""

    pendulum: int
    time_s: float


@dataclass(frozen=True)
class Run:
    """One recorded test.

    Attributes:
        test: "ring-down-x", "ring-down-y", "spin-down", "run-up" or "point-NAME".
        source: the log's path, for messages.
        start_s: the run's start in seconds since 1970; every other time counts from it.
        x_time_s, x_m: laser x, shape (n,), disk-centre displacement; NaN where the sensor said "invalid".
        y_time_s, y_m: laser y, its own samples, shape (m,).
        angle_time_s, angle_rad: pendulum angles θ3, θ4 relative to the rotor, shapes (k,), (k, 2), unwrapped.
        mark_time_s, mark_phase_rad: tachometer marks and ψ at each (unwrapped, ψ = 0: imbalance along +x).
        releases: pendulums let go during the run.
        angle_step_rad: quantisation of the angles, rad.
        clock_rate_std: relative standard uncertainty of each device's rate ("laser_x", "laser_y", "encoder").
        losses: counted losses by stream, as in the log's summary.
        metadata: the log's own facts (rig, point, software version, digest …).
    """

    test: str
    source: str
    start_s: float
    x_time_s: np.ndarray
    x_m: np.ndarray
    y_time_s: np.ndarray
    y_m: np.ndarray
    angle_time_s: np.ndarray
    angle_rad: np.ndarray
    mark_time_s: np.ndarray
    mark_phase_rad: np.ndarray
    releases: tuple[Release, ...] = ()
    angle_step_rad: float = 2 * np.pi / 4096
    clock_rate_std: Mapping[str, float] = field(default_factory=dict)
    losses: Mapping[str, int] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)
