"""Runs for figures, made by the model: a run-up, points, a ring-down at rest, a run without anything."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from analysis.rig_model import RigModel
from daq.signals.run import Run
from dynamics import Scene, SpeedHistory, simulate
from dynamics.motions.integrate import locked_state
from rig_configs import load_rig
from tests.analysis.analysis_runs import draw, point_run

RIG = load_rig("virtual")
MODEL = RigModel.of(RIG, draw(RIG, 1).identified, "parameters.toml")
_NOISE_M = 2e-6
LAG_S = 2e-3
"""By which the run-up's displacements are stamped late."""


_RAMP_S = 16.0


def run_up_history() -> SpeedHistory:
    """How the rotor turns in the run-up."""
    return SpeedHistory.ramp(6.0, 850.0 * math.pi / 30, _RAMP_S, 0.4)


@cache
def run_up(seed: int = 1) -> Run:
    """Through both resonances with the pendulums locked; sensors along the model's axes as these are known."""
    rng = np.random.default_rng(seed)
    history = run_up_history()
    time = np.arange(0.0, _RAMP_S + 1.0, 1e-3)
    phase, speed, _ = history.phase(time).T
    start = locked_state(MODEL.physics, float(speed[0]), float(phase[0]), 0.0, math.pi)
    motion = simulate(MODEL.physics, Scene(history, (False, False), start), time, 1e-4)
    x, y = MODEL.shown(*motion.displacement_m.T, phase)
    marks = 2 * np.pi * np.arange(1, int(phase[-1] / (2 * np.pi)) + 1)
    return _run("run-up", f"run-up-{seed}.mcap", time, x + 1e-4, y, rng, (np.interp(marks, phase, time), marks))


def _run(
    test: str,
    source: str,
    time: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    rng: np.random.Generator,
    marks: tuple[np.ndarray, np.ndarray],
) -> Run:
    return Run(
        test=test,
        source=source,
        start_s=1.7e9,
        x_time_s=time + LAG_S,
        x_m=x + _NOISE_M * rng.standard_normal(len(time)),
        y_time_s=time + LAG_S,
        y_m=y + _NOISE_M * rng.standard_normal(len(time)),
        angle_time_s=time,
        angle_rad=np.tile([0.002, math.pi], (len(time), 1)),
        mark_time_s=marks[0],
        mark_phase_rad=marks[1],
    )


@cache
def point(name: str) -> Run:
    return point_run(RIG, name, 1, drawn=draw(RIG, 1), after_s=30.0)


@cache
def ring_down(seed: int = 1) -> Run:
    """The rotor stands; no index mark is seen."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 6.0, 1e-3)
    swing = 2e-3 * np.exp(-0.4 * time) * np.cos(2 * np.pi * 3.0 * time)
    return _run("ring-down-x", f"ring-down-{seed}.mcap", time, swing, 0.02 * swing, rng, (np.empty(0), np.empty(0)))
