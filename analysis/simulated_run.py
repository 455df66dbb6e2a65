"""Simulation of a recorded run by the model with the measured speed history, lock angles and releases."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analysis.rig_model import LOCKED_RAD, RigModel
from daq.signals.run import Run
from dynamics import Scene, SpeedHistory, simulate
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular

_log = logging.getLogger(__name__)

_SAMPLES_PER_TURN = 32
_MIN_RATE_HZ = 400.0
_ACCURACY = 1e-3
_MIN_MARKS = 6
_LOCKED_S = 2.0  # interval before a release


@dataclass(frozen=True)
class SimulatedRun(Tabular):
    """Motion of the model in sensor axes with run-out.

    Attributes:
        time_s: times since the run's start, evenly spaced, shape (n,).
        phase_rad, speed_rad_s: phase and speed of the rotor, shape (n,).
        x_m, y_m: displacements, shape (n,).
        angle_rad: θ3, θ4, shape (n, 2).
    """

    time_s: Array
    phase_rad: Array
    speed_rad_s: Array
    x_m: Array
    y_m: Array
    angle_rad: Array

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each instant."""
        angles = dict(zip(("theta3_rad", "theta4_rad"), self.angle_rad.T, strict=True))
        names = "time_s", "phase_rad", "speed_rad_s", "x_m", "y_m"
        return {name: getattr(self, name) for name in names} | angles


def speed_history(run: Run) -> SpeedHistory | None:
    """Return the rotor's phase over a run from its marks, twice differentiable; None with too few marks."""
    if len(run.mark_time_s) < _MIN_MARKS:
        return None
    try:
        return SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad)
    except DynamicsError as error:
        _log.info("%s: no speed from the marks: %s", run.source, error)
        return None


def simulate_run(run: Run, model: RigModel) -> SimulatedRun | None:
    """Simulate a run from its first mark to its last.

    The rotor turns as measured. The pendulums are held at their measured angles until the measured releases.

    Returns:
        None if the rotor did not turn, or the simulation is impossible (the motion separates from its neighbours).
    """
    history = speed_history(run)
    if history is None:
        return None
    start, end = float(run.mark_time_s[0]), float(run.mark_time_s[-1])
    top = float(np.max(np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)))
    rate = max(_MIN_RATE_HZ, _SAMPLES_PER_TURN * top / (2 * math.pi))
    time = np.arange(start, end, 1 / rate)
    phase, speed, _ = history.phase(time).T
    theta = locked_angles(run)
    released = tuple(any(r.pendulum == pendulum for r in run.releases) for pendulum in (0, 1))
    times = tuple(min((r.time_s for r in run.releases if r.pendulum == p), default=math.inf) for p in (0, 1))
    try:
        begin = locked_state(model.physics, float(speed[0]), float(phase[0]), *theta)
        scene = Scene(history, (released[0], released[1]), begin, (times[0], times[1]) if any(released) else None)
        motion = simulate(model.physics, scene, time, _ACCURACY)
    except DynamicsError as error:
        _log.info("%s: the run cannot be simulated: %s", run.source, error)
        return None
    x, y = model.shown(motion.displacement_m[:, 0], motion.displacement_m[:, 1], phase)
    return SimulatedRun(time, phase, speed, x, y, np.asarray(motion.angles_rad, np.float64))


NOT_FOLLOWED = (
    "The model does not follow this run: its motion separates from its neighbours, or the rotor did not turn."
)


def locked_angles(run: Run) -> tuple[float, float]:
    """Return θ3, θ4 at which the locks held the pendulums, rad; 0 and π without a record before a release."""
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
