"""The nominal rig and draws over the domain of validity."""

from __future__ import annotations

import math

import numpy as np

from dynamics import Pendulum, RotorParameters


def rig(
    stiffness_ratio: float = 14.9,
    zeta: float = 0.02,
    sp: float = 0.12 * 0.02117,
    mass_b: float = 0.075,
    damping: float = 0.001,
    **more: float,
) -> RotorParameters:
    """The nominal rig with some numbers changed; k1 follows from 3 Hz and the whole mass."""
    mass = 7.0 + 0.12 + 0.075 + mass_b
    k1 = mass * (2 * math.pi * 3) ** 2
    a, b = Pendulum(0.075, 0.054, damping), Pendulum(mass_b, 0.054, damping)
    return RotorParameters(7.0, 0.12, sp / 0.12, a, b, k1, stiffness_ratio * k1, zeta, zeta, **more)


def from_domain(rng: np.random.Generator, *, balanced: bool = False) -> tuple[RotorParameters, float]:
    """One draw over the whole domain of validity: parameters and speed ratio.

    Args:
        balanced: only properly oversized pendulums, so that Type I exists.
    """

    def log(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    heavy = bool(rng.random() < 0.3)
    mass_a = log(1e-9, 7.0) if heavy else 0.075
    mass_b = mass_a if rng.random() < 0.5 else (log(1e-9, 7.0) if heavy else 0.075 * log(0.2, 5.0))
    damping = 0.0 if rng.random() < 0.1 else log(1e-8, 50.0)
    mass = 7.12 + mass_a + mass_b
    k1 = mass * (6 * math.pi) ** 2
    zetas = [0.0 if rng.random() < 0.1 else log(1e-4, 2.0) for _ in range(2)]
    s_a, s_b = mass_a * 0.054, mass_b * 0.054
    if balanced or rng.random() < 0.5:
        sp = abs(s_a - s_b) + rng.random() * (s_a + s_b - abs(s_a - s_b))
        border = rng.random()
        sp = s_a + s_b if border < 0.05 else max(abs(s_a - s_b), 1e-12) if border < 0.1 else sp
    else:
        sp = log(1e-4, 10.0) * (s_a + s_b)
    a, b = Pendulum(mass_a, 0.054, damping), Pendulum(mass_b, 0.054, damping)
    return RotorParameters(7.0, 1.0, sp, a, b, k1, log(1e-2, 1e4) * k1, *zetas), log(1e-3, 100.0)
