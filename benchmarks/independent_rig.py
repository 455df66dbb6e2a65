"""The rig written down once more, for benchmarks: point masses, their Lagrangian's mass matrix, scipy's DOP853.

Shares no line with the dynamics package, so that what identification finds from these readings is no circle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from daq.signals.run import Release, Run
from dynamics.equations.parameters import RotorParameters


@dataclass(frozen=True)
class Encoders:
    """How angles are read.

    Attributes:
        step_rad, rate_Hz: of one encoder.
        jitter: noise before the rounding, in steps.
        lost: share of samples that never arrive.
    """

    step_rad: float = 2 * np.pi / 2000
    rate_Hz: float = 1000.0
    jitter: float = 0.0
    lost: float = 0.02

    def read(self, angle_rad: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        noisy = angle_rad + self.jitter * self.step_rad * rng.standard_normal(angle_rad.shape)
        return np.round(noisy / self.step_rad) * self.step_rad


@njit(cache=True)
def _slope(t, y, p):
    """p = mass, k1, k2, c1, c2, SA, SB, SP, JA, JB, cA, cB, speed, phase."""
    out, m, f = np.empty(8), np.zeros((4, 4)), np.zeros(4)
    speed, psi = p[12], p[13] + p[12] * t
    m[0, 0] = m[1, 1] = p[0]
    f[0] = -p[1] * y[0] - p[3] * y[4] + p[7] * speed**2 * np.cos(psi)
    f[1] = -p[2] * y[1] - p[4] * y[5] + p[7] * speed**2 * np.sin(psi)
    for i in range(2):
        s, phi, rate = p[5 + i], psi + y[2 + i], speed + y[6 + i]
        m[2 + i, 2 + i] = p[8 + i]
        m[0, 2 + i] = m[2 + i, 0] = -s * np.sin(phi)
        m[1, 2 + i] = m[2 + i, 1] = s * np.cos(phi)
        f[0] += s * rate**2 * np.cos(phi)
        f[1] += s * rate**2 * np.sin(phi)
        f[2 + i] = -p[10 + i] * y[6 + i]
    out[:4] = y[4:]
    out[4:] = np.linalg.solve(m, f)
    return out


def _numbers(physics: RotorParameters, speed: float, phase: float) -> np.ndarray:
    (c1, c2), a, b = physics.damping_Ns_per_m, physics.a, physics.b
    return np.array([
        physics.total_mass_kg, physics.k1_N_per_m, physics.k2_N_per_m, c1, c2,
        a.mass_kg * a.length_m, b.mass_kg * b.length_m, physics.imbalance_moment_kg_m,
        a.mass_kg * a.length_m**2, b.mass_kg * b.length_m**2, a.damping_Nms_per_rad, b.damping_Nms_per_rad,
        speed, phase,
    ])  # fmt: skip


def release_run(
    physics: RotorParameters, speed_Hz: float, rng: np.random.Generator, encoders: Encoders, zeros_rad: np.ndarray,
    record_s: float = 5.0, laser_noise_m: float = 10e-6,
) -> Run:  # fmt: skip
    """Three seconds locked, then both pendulums let go; speed constant; lasers at 1 kHz, encoders, index marks."""
    speed, psi0 = 2 * np.pi * speed_Hz, rng.uniform(-np.pi, np.pi)
    go = 3.0 + rng.uniform(0, 0.2)
    locked = np.radians(np.array([0.0, 180.0]) + rng.uniform(-0.2, 0.2, 2))
    p = _numbers(physics, speed, psi0)
    moment = p[7] + p[5] * np.exp(1j * locked[0]) + p[6] * np.exp(1j * locked[1])
    x, y = (moment * speed**2 / (p[1 + i] - p[0] * speed**2 + 1j * speed * p[3 + i]) for i in range(2))
    time = np.arange(0, go + record_s, 1 / encoders.rate_Hz)

    def orbit(t: np.ndarray) -> np.ndarray:
        turn = np.exp(1j * (psi0 + speed * t))
        xd, yd = (1j * speed * x * turn).real, (1j * speed * y * turn).imag
        return np.array([(x * turn).real, (y * turn).imag, 0 * t + locked[0], 0 * t + locked[1], xd, yd, 0 * t, 0 * t])

    after = time >= go
    free = solve_ivp(
        _slope, (go, time[-1]), orbit(np.array([go]))[:, 0], "DOP853", time[after], args=(p,), rtol=1e-10, atol=1e-12
    )
    state = np.hstack([orbit(time[~after]), free.y])
    keep = rng.random(len(time)) > encoders.lost
    angle = encoders.read(state[2:4].T + zeros_rad, rng)[keep]
    turns = 2 * np.pi * np.arange(np.ceil(psi0 / (2 * np.pi)), (psi0 + speed * time[-1]) // (2 * np.pi))
    marks = (turns - psi0) / speed + 1e-6 * rng.standard_normal(len(turns))
    told = go + 5e-4 * rng.standard_normal()
    lasers = state[:2] + laser_noise_m * rng.standard_normal((2, len(time)))
    return Run(
        "point-C", "independent release", 0.0, time, lasers[0], time, lasers[1], time[keep], angle, marks, turns,
        (Release(0, told), Release(1, told)), encoders.step_rad,
    )  # fmt: skip
