"""A point's run as the rig would log it, made from the model with the rig's imperfections; seeded."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from daq.signals.run import Release, Run
from dynamics import RotorParameters, Scene, SpeedHistory, simulate
from dynamics.motions.integrate import locked_state
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, Rig

STEP = 2 * np.pi / 4096
IDENTIFIED_STD = {
    "k1_N_per_m": 7e-5,
    "k2_N_per_m": 8e-5,
    "zeta1": 2e-3,
    "zeta2": 2e-3,
    "c3_Nms_per_rad": 4e-3,
    "c4_Nms_per_rad": 4e-3,
    "SP_kg_m": 8e-4,
}
AXIS_STD_DEG = 0.01


@dataclass(frozen=True)
class Drawn:
    """One seed's rig: calibration errors and what an identification would have found."""

    gain: tuple[float, float]
    zero_rad: np.ndarray
    laser_delay_s: float
    identified: IdentifiedParameters
    axis_angle_deg: tuple[float, float]


def draw(rig: Rig, seed: int) -> Drawn:
    rng = np.random.default_rng(seed)
    true = rig.true_physics.identified()
    std = np.array([IDENTIFIED_STD[name] * abs(true[name]) for name in PARAMETER_UNITS])
    values = {n: true[n] + s * rng.standard_normal() for n, s in zip(PARAMETER_UNITS, std, strict=True)}
    d = rig.devices
    return Drawn(
        (1 + d["laser_x"].gain_std * rng.standard_normal(), 1 + d["laser_y"].gain_std * rng.standard_normal()),
        np.radians(d["encoder"].zero_std_deg) * rng.standard_normal(2),
        2e-3 * rng.standard_normal(),
        IdentifiedParameters(values, np.diag(std**2)),
        (1.0 + AXIS_STD_DEG * rng.standard_normal(), AXIS_STD_DEG),
    )


def point_run(
    rig: Rig,
    name: str,
    seed: int = 0,
    *,
    after_s: float = 70.0,
    physics: RotorParameters | None = None,
    drawn: Drawn | None = None,
    start_deg: tuple[float, float] | None = None,
    stop: bool = True,
    speed: float | None = None,
    before_s: float = 4.0,
    accuracy: float = 1e-2,
) -> Run:
    """Locked for before_s, released at t = before_s, then after_s at speed and half a second of the stop.

    accuracy: of the motion; 1e-2 leaves some thousandths of a degree, 1e-5 nothing that any sensor shows.
    """
    rng = np.random.default_rng([seed, ord(name[0])])
    physics = physics or rig.true_physics
    drawn = drawn or draw(rig, seed)
    w = speed or 0.998 * rig.physics.speed_rad_s(rig.points[name].speed_ratio)
    start = np.radians(start_deg) if start_deg else np.array([0.0, np.pi]) + np.radians(0.2 * rng.uniform(-1, 1, 2))
    end = before_s + after_s + (0.5 if stop else 0.0)
    history = _history(w, before_s + after_s, end)
    laser_t = np.arange(0.0, end, 1 / 4000)
    angle_t = np.arange(0.0, end, 1e-3)
    state = _state(physics, history, w, start, before_s, angle_t, accuracy)
    noise = rig.virtual.sensors.laser_noise_m if rig.virtual else 4e-6
    beta, late_s = math.radians(1.0), 1.1e-4
    x, y = _displacement(state, angle_t, laser_t + drawn.laser_delay_s)
    x_s = drawn.gain[0] * (x * math.cos(beta) + y * math.sin(beta)) + 0.3e-3
    x, y = _displacement(state, angle_t, laser_t + drawn.laser_delay_s + late_s)
    y_s = drawn.gain[1] * (-x * math.sin(beta) + y * math.cos(beta)) - 0.1e-3
    counts = (state[:, 2:4] + drawn.zero_rad) / STEP + 0.3 * rng.standard_normal((len(angle_t), 2))
    keep = _bursts(rng, len(angle_t))
    marks = _marks(history, end)
    return Run(
        test=f"point-{name}",
        source=f"synthetic-{name}-{seed}.mcap",
        start_s=1.7e9,
        x_time_s=laser_t,
        x_m=x_s + noise * rng.standard_normal(len(x_s)),
        y_time_s=laser_t + late_s,
        y_m=y_s + noise * rng.standard_normal(len(y_s)),
        angle_time_s=angle_t[keep],
        angle_rad=np.round(counts[keep]) * STEP,
        mark_time_s=marks[0],
        mark_phase_rad=marks[1],
        releases=(Release(0, before_s), Release(1, before_s)),
        losses={"pendulums": int((~keep).sum())},
        metadata={"rig": rig.name, "point": name},
    )


def _history(w: float, stop_at: float, end: float) -> SpeedHistory:
    knots = np.array([0.0, stop_at, max(end, stop_at + 1e-6)])
    return SpeedHistory(knots, np.array([[0.3, w, 0.0, 0.0], [0.3 + w * stop_at, w, -6.0, 0.0]]))


def _state(
    physics: RotorParameters,
    history: SpeedHistory,
    w: float,
    start: np.ndarray,
    before: float,
    t: np.ndarray,
    accuracy: float,
) -> np.ndarray:
    locked = t <= before
    psi = history.phase(t[locked])[:, 0]
    rows = np.array([locked_state(physics, w, p, start[0], start[1]) for p in psi])
    at_release = rows[-1]
    free = simulate(physics, Scene(history, (True, True), at_release), t[np.sum(locked) - 1 :], accuracy)
    return np.vstack([rows[:-1], free.state])


def _displacement(state: np.ndarray, t: np.ndarray, laser_t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x, y at the lasers' instants by Hermite interpolation, good to nanometres over a millisecond."""
    from scipy.interpolate import CubicHermiteSpline

    at = np.clip(laser_t, t[0], t[-1])
    return (
        CubicHermiteSpline(t, state[:, 0], state[:, 4])(at),
        CubicHermiteSpline(t, state[:, 1], state[:, 5])(at),
    )


def _marks(history: SpeedHistory, end: float) -> tuple[np.ndarray, np.ndarray]:
    grid = np.linspace(0, end, 20001)
    psi = history.phase(grid)[:, 0]
    phases = 2 * np.pi * np.arange(1, math.floor(psi[-1] / (2 * np.pi)) + 1)
    times = np.interp(phases, psi, grid)
    for _ in range(3):
        now = history.phase(times)
        times = times - (now[:, 0] - phases) / now[:, 1]
    return times, phases


def _bursts(rng: np.random.Generator, n: int) -> np.ndarray:
    keep = np.ones(n, bool)
    for start in np.flatnonzero(rng.random(n) < 0.002):
        keep[start : start + rng.geometric(0.4)] = False
    return keep
