"""Angles near the frictionless rest at which dry friction holds a pendulum.

The mean torque near a rest position is K δθ. Friction F φ̇² = F ω² holds as long as |K δθ| ≤ F ω² for each pendulum.
The band therefore extends |K⁻¹| F ω² to either side.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.integrate import locked_orbit


def stick_half_width(p: RotorParameters, speed: float, theta: tuple[float, float]) -> tuple[float, float]:
    """Largest deviation of each pendulum from its rest at which dry friction holds it, to first order.

    Args:
        theta: θ3, θ4 of a frictionless rest, rad.
    Returns:
        Half widths for A and B, rad; π if friction holds at any angle, 0 without friction.
    """
    arms = np.array([p.a.friction_arm_m * p.a.first_moment_kg_m, p.b.friction_arm_m * p.b.first_moment_kg_m])
    if not np.any(arms):
        return 0.0, 0.0
    step = 1e-6
    slope = np.empty((2, 2))
    for j in range(2):
        ends: list[Array] = []
        for sign in (1, -1):
            moved = [theta[i] + (sign * step if i == j else 0.0) for i in range(2)]
            ends.append(_mean_torque(p, speed, (moved[0], moved[1])))
        slope[:, j] = (ends[0] - ends[1]) / (2 * step)
    try:
        reach = np.abs(np.linalg.inv(slope)) @ (arms * speed**2)
    except np.linalg.LinAlgError:  # usual: no restoring torque
        return math.pi, math.pi
    return min(float(reach[0]), math.pi), min(float(reach[1]), math.pi)


def held_share(p: RotorParameters, speed: float, theta: tuple[float, float]) -> tuple[float, float]:
    """Ratio of the mean torque on pendulums at rest on the rotor to the largest friction torque, not linearised.

    Args:
        theta: θ3, θ4 of the pendulums, rad.
    Returns:
        Ratios of A and B. Above 1 friction does not hold; inf without friction and with a torque.
    """
    arms = (p.a.friction_arm_m * p.a.first_moment_kg_m, p.b.friction_arm_m * p.b.first_moment_kg_m)
    shares = [
        0.0 if torque == 0.0 else abs(float(torque)) / (arm * speed**2) if arm else math.inf
        for torque, arm in zip(_mean_torque(p, speed, theta).tolist(), arms, strict=True)
    ]
    return shares[0], shares[1]


def _mean_torque(p: RotorParameters, speed: float, theta: tuple[float, float]) -> Array:
    """Torque on pendulums at rest on the rotor, mean over a revolution, N m, shape (2,)."""
    x, y = locked_orbit(p, speed, *theta)
    pivot = (x + y) / 2 + p.pivot_shift_m
    moments = (p.a.first_moment_kg_m, p.b.first_moment_kg_m)
    return np.array(
        [-(speed**2) * s * (np.conj(pivot) * np.exp(1j * t)).imag for s, t in zip(moments, theta, strict=True)]
    )
