# pyright: strict
"""A recorded run done again by the model: the measured speed history, the measured locks and releases."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.rig_model import LOCKED_RAD, RigModel
from daq.signals.run import Run
from dynamics import Scene, SpeedHistory, simulate
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state

Array = NDArray[np.float64]

_PER_TURN = 32
_LEAST_RATE_HZ = 400.0
_ACCURACY = 1e-3
_LEAST_MARKS = 6
_LOCKED_S = 2.0  # before a release


@dataclass(frozen=True)
class SimulatedRun:
    """The model's motion in sensor axes, run-out included.

    Attributes:
        time_s: since the run's start, evenly spaced, shape (n,).
        phase_rad, speed_rad_s: of the rotor, shape (n,).
        x_m, y_m: shape (n,).
        angle_rad: θ3, θ4, shape (n, 2).
    """

    time_s: Array
    phase_rad: Array
    speed_rad_s: Array
    x_m: Array
    y_m: Array
    angle_rad: Array


def speed_history(run: Run) -> SpeedHistory | None:
    """The rotor's phase over a run by its marks, twice differentiable; None with too few of them."""
    if len(run.mark_time_s) < _LEAST_MARKS:
        return None
    try:
        return SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad)
    except DynamicsError:
        return None


def simulate_run(run: Run, model: RigModel) -> SimulatedRun | None:
    """A run's motion from its first mark to its last.

    The rotor turns as measured. The pendulums are held where they stood before the first release, and let go when they
    were.

    Returns:
        None where the rotor did not turn, or the model cannot follow (the motion separates from its neighbours).
    """
    history = speed_history(run)
    if history is None:
        return None
    start, end = float(run.mark_time_s[0]), float(run.mark_time_s[-1])
    top = float(np.max(np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)))
    rate = max(_LEAST_RATE_HZ, _PER_TURN * top / (2 * math.pi))
    time = np.arange(start, end, 1 / rate)
    phase, speed, _ = history.phase(time).T
    theta = locked_angles(run)
    released = tuple(any(r.pendulum == pendulum for r in run.releases) for pendulum in (0, 1))
    times = tuple(min((r.time_s for r in run.releases if r.pendulum == p), default=math.inf) for p in (0, 1))
    try:
        begin = locked_state(model.physics, float(speed[0]), float(phase[0]), *theta)
        scene = Scene(history, (released[0], released[1]), begin, (times[0], times[1]) if any(released) else None)
        motion = simulate(model.physics, scene, time, _ACCURACY)
    except DynamicsError:
        return None
    x, y = model.shown(motion.displacement_m[:, 0], motion.displacement_m[:, 1], phase)
    return SimulatedRun(time, phase, speed, x, y, np.asarray(motion.angles_rad, np.float64))


NOT_FOLLOWED = (
    "The model does not follow this run: its motion separates from its neighbours, or the rotor did not turn."
)


def locked_angles(run: Run) -> tuple[float, float]:
    """θ3, θ4 at which the locks held the pendulums, rad; 0 and π where nothing was recorded before a release."""
    go = min((r.time_s for r in run.releases), default=math.inf)
    if math.isinf(go):
        before = run.angle_time_s < math.inf
    else:
        before = (run.angle_time_s < go - 0.02) & (run.angle_time_s > go - _LOCKED_S)
    held = run.angle_rad[before]
    held = held[np.isfinite(held).all(axis=1)] if len(held) else held
    if len(held) == 0:
        return LOCKED_RAD
    theta3, theta4 = np.median(held, axis=0).tolist()
    return theta3, theta4
