"""The independent rig with dry friction: slides and sticks, by the laboratory's equations (benchmarks.worlds.motion).

A torque −sign(θ̇) (M + F φ̇²) on each pendulum that slides and none of its own on one that sticks. Shares no line with
the dynamics and identification packages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.worlds.motion import Mechanics, SwingingMass, Turning, moved

_STEP_S = 1e-4


@dataclass(frozen=True)
class Dry:
    """Friction of A and B: a torque at any speed, N m, and one with the contact force, kg m²."""

    torque_Nm: tuple[float, float] = (0.0, 0.0)
    contact_kg_m2: tuple[float, float] = (0.0, 0.0)


def swings(start: np.ndarray, times: np.ndarray, p: np.ndarray, friction: Dry) -> np.ndarray:
    """Both pendulums free from `start` at times[0]; states at the times, shape (n, 8).

    Args:
        p: mass, k1, k2, c1, c2, SA, SB, SP, JA, JB, cA, cB, speed, phase at t = 0; SI.
    """
    mass, k1, k2, c1, c2, *moments, imbalance = (float(value) for value in p[:8])
    a, b = (
        SwingingMass(moment**2 / inertia, inertia / moment, damping, 0.0, torque, contact)
        for moment, inertia, damping, torque, contact in zip(
            moments, p[8:10].tolist(), p[10:12].tolist(), friction.torque_Nm, friction.contact_kg_m2, strict=True
        )
    )
    mechanics = Mechanics(mass, (k1, k2), (c1, c2), imbalance, a, b)
    return moved(mechanics, Turning.steady(float(p[13]), float(p[12])), times, start, True, _STEP_S)
