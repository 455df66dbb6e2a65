"""Updates a second of the compiled unscented filter, against filterpy's with the same compiled motion."""

from __future__ import annotations

import time

import numpy as np
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
from numba import njit

from dynamics.equations.kernels import CA, CB, rk4_step
from identification.tracking.unscented import TALLY, filter_readings
from rig_configs.load import load_rig

_STEP_S, _SPEED = 1e-3, 50.0
_STEPS, _PEER_STEPS, _REPEATS = 20_000, 1_000, 5
_NOISE = np.r_[np.zeros(4), 1e-7, 1e-7, 1e-4, 1e-4, 1e-5, 1e-5]
_START = np.r_[1e-4, 0, 0.3, 2.8, 0, 5e-3, 0, 0, np.log(1e-3), np.log(1e-3)]
_SPREAD = np.r_[1e-4, 1e-4, 0.01, 0.01, 1e-2, 1e-2, 0.1, 0.1, 0.5, 0.5] ** 2


@njit(cache=True, error_model="numpy")
def _motion(y, dt, psi, speed, packed):
    """One Runge–Kutta step of the ten-state model, both pendulums free."""
    p, out, k = packed.copy(), y.copy(), np.empty((5, 8))
    p[CA], p[CB] = np.exp(y[8]), np.exp(y[9])
    phases = np.zeros((3, 3))
    phases[:, 0] = psi + speed * dt * np.array([0.0, 0.5, 1.0])
    phases[:, 1] = speed
    rk4_step(out[:8], dt, phases[0], phases[1], phases[2], p, 1.0, 1.0, k[0], k[1], k[2], k[3], k[4])
    return out


def _readings(steps: int) -> np.ndarray:
    packed, rng, y, out = load_rig("virtual").physics.packed(), np.random.default_rng(0), _START.copy(), []
    for i in range(steps):
        y = _motion(y, _STEP_S, _SPEED * _STEP_S * i, _SPEED, packed)
        out.append(y[:4] + np.r_[1e-5, 1e-5, 1e-3, 1e-3] * rng.standard_normal(4))
    return np.array(out)


def _own(readings: np.ndarray) -> tuple[float, np.ndarray]:
    packed, n = load_rig("virtual").physics.packed(), len(readings)
    times = np.repeat(_STEP_S * np.arange(1, n + 1), 4)
    phases = np.zeros((4 * n, 3))
    phases[:, 0], phases[:, 1] = _SPEED * np.r_[0.0, times[:-1]], _SPEED
    mean, cov, tally, z = _START.copy(), np.diag(_SPREAD), np.zeros(TALLY), np.empty(4 * n)
    began = time.perf_counter()
    filter_readings(
        mean,
        cov,
        times,
        np.zeros(4 * n),
        np.tile(np.arange(4), n),
        readings.ravel(),
        np.tile(np.r_[1e-10, 1e-10, 1e-6, 1e-6], n),
        phases,
        np.ones((4 * n, 2)),
        packed,
        _NOISE,
        1.0,
        8.0,
        -1.0,
        tally,
        z,
    )
    return n / (time.perf_counter() - began), mean


def _peer(readings: np.ndarray) -> tuple[float, np.ndarray]:
    packed = load_rig("virtual").physics.packed()
    points = JulierSigmaPoints(10, kappa=0.0)
    ukf = UnscentedKalmanFilter(10, 4, _STEP_S, lambda y: y[:4], _motion, points)
    ukf.x, ukf.P, ukf.Q, ukf.R = (
        _START.copy(),
        np.diag(_SPREAD),
        np.diag(_NOISE) * _STEP_S,
        np.diag([1e-10, 1e-10, 1e-6, 1e-6]),
    )
    began = time.perf_counter()
    for i, reading in enumerate(readings):
        ukf.predict(psi=_SPEED * _STEP_S * i, speed=_SPEED, packed=packed)
        ukf.update(reading)
    return len(readings) / (time.perf_counter() - began), ukf.x


def print_speeds() -> None:
    """Both filters on the same readings, medians of interleaved repeats; and how far apart they end."""
    readings = _readings(_STEPS)
    _own(readings[:10])
    _peer(readings[:10])
    pairs = [(_own(readings)[0], _peer(readings[:_PEER_STEPS])[0]) for _ in range(_REPEATS)]
    own, peer = np.median(np.array(pairs), axis=0)
    apart = np.max(np.abs(_own(readings[:_PEER_STEPS])[1] - _peer(readings[:_PEER_STEPS])[1]) / np.sqrt(_SPREAD))
    print("\nUnscented filter, 10 states, 4 readings an update")
    print(f"  compiled whole {own:9.0f} updates/s (best {max(p[0] for p in pairs):.0f})")
    print(f"  filterpy       {peer:9.0f} updates/s with compiled motion; ratio {own / peer:.1f}")
    print(f"  the two end {apart:.1e} start standard deviations apart after {_PEER_STEPS} updates")
