"""Shift of a steady motion with oscillating, never sticking pendulums by dry friction, to first order in the friction.

If the suspension differs between x and y, the pendulums of Types II and III oscillate twice a revolution. Friction
−M sign θ̇ is then a periodic torque on the frictionless motion y(t). With the linearised motion's Φ(t), and b(t) the
accelerations due to a torque of 1 N m on a pendulum,

    δy(t) = Φ(t) (δy0 + ∫₀ᵗ Φ(s)⁻¹ b(s) (−M sign θ̇(s)) ds),      δy0 = (1 − ∂H/∂y)⁻¹ H-turn Φ(T) ∫₀ᵀ …,

T half a revolution. Viscous damping with the same power shifts the angles by half of it: an oscillation with even
harmonics has unequal durations in both directions, so friction has a mean. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.parameters import RotorParameters

Motion = Callable[[Array, Array], Array]
"""Function from (state at ψ = 0, instants) to states (n, 8) of the rig with both pendulums free."""

_INSTANTS = 128
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])  # x and y change sign after half a revolution
_STEPS = np.array([1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3])
_MIN_RATE_RAD_S = 1e-6  # smallest rate of an oscillation


def sliding_shift(p: RotorParameters, speed: float, start: Array, motion: Motion, torque_Nm: Array) -> Complex:
    """Shifts of mean θ3, θ4 (rad) and of the complex order-1 amplitudes of x and y (m), shape (4,) complex.

    Args:
        speed: speed of the rotor, rad/s.
        start: state of the frictionless steady motion at ψ = 0, shape (8,).
        motion: function that integrates the motion.
        torque_Nm: dry friction of A and B, N m, shape (2,). A pendulum that does not oscillate sticks and is omitted.
    """
    times = np.linspace(0, math.pi / speed, _INSTANTS + 1)
    states = motion(start, times)
    wobbles = np.max(np.abs(states[:, 6:8]), axis=0) > _MIN_RATE_RAD_S
    if not np.any(wobbles & (torque_Nm > 0)):
        return np.zeros(4, np.complex128)
    along = np.stack(
        [(motion(start + e, times) - motion(start - e, times)) / (2 * h) for e, h in _nudges()], axis=2
    )  # Φ at each instant, shape (n, 8, 8)
    push = _push(p, speed, times, states) @ np.diag(torque_Nm * wobbles)
    pulls = np.asarray(np.linalg.solve(along, push), np.float64)
    forced = -0.5 * np.einsum("nij,nj->ni", pulls[1:] + pulls[:-1], _mean_sign(states[:, 6:8]))
    gathered = np.concatenate([np.zeros((1, 8)), np.cumsum((times[1] - times[0]) * forced, axis=0)])
    whole = _TURN[:, None] * along[-1]
    first = np.asarray(np.linalg.solve(np.eye(8) - whole, whole @ gathered[-1]), np.float64)
    moved = np.einsum("nij,nj->ni", along, first + gathered)
    turn = np.exp(-1j * speed * times)
    return np.array([*_mean(moved[:, 2:4]), *(2 * _mean(moved[:, :2] * turn[:, None]))], np.complex128)


def _nudges() -> list[tuple[Array, float]]:
    return list(zip(np.diag(_STEPS), _STEPS.tolist(), strict=True))


def _mean_sign(rates: Array) -> Array:
    """Mean sign of linearly interpolated rates between instants, shape (n − 1, 2)."""
    change, size = np.diff(rates, axis=0), np.diff(np.abs(rates), axis=0)
    return np.where(np.abs(change) > 0, size / np.where(change == 0, 1.0, change), np.sign(rates[1:]))


def _mean(values: Complex | Array) -> Complex:
    """Mean over half a revolution by the trapezoidal rule, exact for odd orders times e^{−iψ} and for even orders."""
    return np.asarray((values[1:-1].sum(axis=0) + 0.5 * (values[0] + values[-1])) / (len(values) - 1), np.complex128)


def _push(p: RotorParameters, speed: float, times: Array, states: Array) -> Array:
    """Rates of the state due to a torque on each pendulum, shape (n, 8, 2)."""
    moments = np.array([p.a.first_moment_kg_m, p.b.first_moment_kg_m])
    inertias = np.array([p.a.inertia_kg_m2, p.b.inertia_kg_m2])
    phi = speed * times[:, None] + states[:, 2:4]
    matrix = np.zeros((len(times), 4, 4))
    matrix[:, 0, 0] = matrix[:, 1, 1] = p.total_mass_kg
    for i in range(2):
        matrix[:, 0, 2 + i] = matrix[:, 2 + i, 0] = -moments[i] * np.sin(phi[:, i])
        matrix[:, 1, 2 + i] = matrix[:, 2 + i, 1] = moments[i] * np.cos(phi[:, i])
        matrix[:, 2 + i, 2 + i] = inertias[i]
    unit = np.broadcast_to(np.eye(4)[:, 2:], (len(times), 4, 2))
    out = np.zeros((len(times), 8, 2))
    out[:, 4:] = np.linalg.solve(matrix, unit)
    return out
