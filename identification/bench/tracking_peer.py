"""Tracking by filterpy's unscented Kalman filter with a compiled motion, from the encoders alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numba import njit

from identification.bench.releases import LOCKED_S, RATE_HZ, ReleaseRecord, equation_numbers, slope
from identification.bench.trials import MethodResult
from identification.pendulums.suspension_knowledge import NAMES

_STATES, _READINGS = 10, 2  # x, y, θ3, θ4, their rates, ln c3, ln c4
_STEPS = 2  # Runge–Kutta steps per sample
_WANDER = 3e-3  # random walk of ln c per square root of a second
_PUSH = np.array([0.05, 0.05, 1.0, 1.0])  # unmodelled accelerations, m/s² and rad/s² per square root of a Hz


def updates(record: ReleaseRecord) -> int:
    """Return the number of predictions with readings: encoder samples after the release."""
    return int(np.count_nonzero(record.run.angle_time_s > LOCKED_S))


def unscented_filter(record: ReleaseRecord) -> MethodResult:
    """Return the last estimate of ln c3 and ln c4, states nine and ten, with 1.96 standard deviations."""
    run, physics = record.run, record.knowledge.physics
    rate, phase = np.polyfit(run.mark_time_s, run.mark_phase_rad, 1)
    given = physics.identified()
    damping = np.array([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad])
    numbers = equation_numbers(physics, damping, np.array([given[n] for n in NAMES]), float(phase))
    numbers[1] = rate
    step = 1 / RATE_HZ
    after = run.angle_time_s > LOCKED_S
    ticks = np.round(run.angle_time_s[after] * RATE_HZ).astype(int)
    readings = dict(zip(ticks.tolist(), run.angle_rad[after], strict=True))
    points = MerweScaledSigmaPoints(_STATES, alpha=1.0, beta=2.0, kappa=0.0)
    own: Any = UnscentedKalmanFilter(_STATES, _READINGS, step, _read_angles, _carried, points)
    start = round(LOCKED_S * RATE_HZ)
    own.x = np.r_[0.0, 0.0, run.angle_rad[~after].mean(axis=0), np.zeros(4), np.log(damping)]
    own.P = np.diag(np.r_[1e-3, 1e-3, 0.002, 0.002, 0.05, 0.05, 0.1, 0.1, np.full(2, np.log(10.0))] ** 2)
    own.R = np.eye(_READINGS) * (run.angle_step_rad**2 / 12 + 1e-6)
    own.Q = np.diag(np.r_[np.zeros(4), _PUSH**2 * 1e-4 * step, np.full(2, _WANDER**2 * step)])
    for tick in range(start + 1, int(ticks[-1]) + 1):
        own.predict(t=(tick - 1) * step, numbers=numbers)
        own.update(readings.get(tick))
    std = np.sqrt(np.diag(own.P))
    names = ("c3_Nms_per_rad", "c4_Nms_per_rad")
    values = {n: float(np.exp(own.x[8 + i])) for i, n in enumerate(names)}
    reach = {n: float(np.exp(1.96 * std[8 + i])) for i, n in enumerate(names)}
    return MethodResult(values, {n: (v / reach[n], v * reach[n]) for n, v in values.items()})


def _read_angles(state: np.ndarray) -> np.ndarray:
    return state[2:4]


@njit(cache=True, nogil=True, error_model="numpy")
def _carried(state: np.ndarray, dt: float, t: float, numbers: np.ndarray) -> np.ndarray:
    """Return a sigma point after one sample."""
    own = numbers.copy()
    own[12:14] = np.exp(state[8:10])
    out = state.copy()
    y, h = state[:8].copy(), dt / _STEPS
    for i in range(_STEPS):
        at = t + i * h
        k1 = slope(at, y, own)
        k2 = slope(at + h / 2, y + h / 2 * k1, own)
        k3 = slope(at + h / 2, y + h / 2 * k2, own)
        k4 = slope(at + h, y + h * k3, own)
        y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    out[:8] = y
    return out
