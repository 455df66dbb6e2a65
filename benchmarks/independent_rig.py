"""A release of a given rig, recorded: the laboratory's equations (benchmarks.worlds.motion), lasers, encoders, marks.

Shares no line with the dynamics package, so that what identification finds from these readings is no circle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.worlds.motion import Mechanics, SwingingMass, Turning, moved
from daq.signals.run import Release, Run
from dynamics.equations.parameters import RotorParameters

_STEP_S = 1e-4


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


def mechanics_of(physics: RotorParameters) -> Mechanics:
    """A rig's numbers as the laboratory's equations take them."""
    a, b = (SwingingMass(own.mass_kg, own.length_m, own.damping_Nms_per_rad) for own in (physics.a, physics.b))
    k = (physics.k1_N_per_m, physics.k2_N_per_m)
    return Mechanics(physics.total_mass_kg, k, physics.damping_Ns_per_m, physics.imbalance_moment_kg_m, a, b)


def release_run(
    physics: RotorParameters,
    speed_Hz: float,
    rng: np.random.Generator,
    encoders: Encoders,
    zeros_rad: np.ndarray,
    record_s: float = 5.0,
    laser_noise_m: float = 10e-6,
) -> Run:
    """Three seconds locked, then both pendulums released; speed constant; lasers at 1 kHz, encoders, index marks."""
    speed, psi0 = 2 * np.pi * speed_Hz, rng.uniform(-np.pi, np.pi)
    go = 3.0 + rng.uniform(0, 0.2)
    locked = np.radians(np.array([0.0, 180.0]) + rng.uniform(-0.2, 0.2, 2))
    mechanics, turning = mechanics_of(physics), Turning.steady(psi0, speed)
    x, y = mechanics.locked_orbit(speed, locked)
    time = np.arange(0, go + record_s, 1 / encoders.rate_Hz)

    def orbit(t: np.ndarray) -> np.ndarray:
        turn = np.exp(1j * (psi0 + speed * t))
        xd, yd = (1j * speed * x * turn).real, (1j * speed * y * turn).real
        return np.array([(x * turn).real, (y * turn).real, 0 * t + locked[0], 0 * t + locked[1], xd, yd, 0 * t, 0 * t])

    after = time >= go
    free = moved(mechanics, turning, np.r_[go, time[after]], orbit(np.array([go]))[:, 0], True, _STEP_S)[1:]
    state = np.hstack([orbit(time[~after]), free.T])
    keep = rng.random(len(time)) > encoders.lost
    angle = encoders.read(state[2:4].T + zeros_rad, rng)[keep]
    turns = 2 * np.pi * np.arange(np.ceil(psi0 / (2 * np.pi)), (psi0 + speed * time[-1]) // (2 * np.pi))
    marks = (turns - psi0) / speed + 1e-6 * rng.standard_normal(len(turns))
    release_s = go + 5e-4 * rng.standard_normal()
    lasers = state[:2] + laser_noise_m * rng.standard_normal((2, len(time)))
    return Run(
        "point-C",
        "independent release",
        0.0,
        time,
        lasers[0],
        time,
        lasers[1],
        time[keep],
        angle,
        marks,
        turns,
        (Release(0, release_s), Release(1, release_s)),
        encoders.step_rad,
    )
