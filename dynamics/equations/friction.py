"""Dry friction as a set-valued torque: which pendulum slides, in which direction, and which sticks.

Friction holds a pendulum with any torque up to F φ̇² and opposes its sliding with exactly that torque (F = friction arm
× first moment, dynamics.equations.kernels). A pendulum is therefore in one of three modes: it slides forward (θ̇ > 0),
slides backward, or sticks (θ̇ = 0). A sticking pendulum needs the torque
    T = S n·(p̈ + g ŷ) − D α
and sticks as long as |T| ≤ F ω². Within a mode the motion is smooth. Modes change only at instants that the integrator
locates (docs/theory/integration.md), so the sign of a small speed is never evaluated.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import DA, FA, GRAVITY, JA, RC, SA, rates
from dynamics.errors import NotConverged

FORWARD, BACKWARD, STUCK = 1, -1, 0
Modes = tuple[int, int]


@compiled
def needed_torque(
    pendulum: int, y: Array, psi: float, omega: float, alpha: float, p: Array, free_a: float, free_b: float, out: Array
) -> float:
    """Torque that holds pendulum 0 (A) or 1 (B) at rest on the rotor, N m. `out` is scratch, shape (8,)."""
    rates(y, psi, omega, alpha, p, free_a, free_b, out)
    phi = psi + y[2 + pendulum]
    sin_phi, cos_phi = np.sin(phi), np.cos(phi)
    sin_psi, cos_psi = np.sin(psi), np.cos(psi)
    px = out[4] - p[RC] * (alpha * sin_psi + omega * omega * cos_psi)
    py = out[5] + p[RC] * (alpha * cos_psi - omega * omega * sin_psi) + p[GRAVITY]
    return p[SA + pendulum] * (sin_phi * px - cos_phi * py) - p[DA + pendulum] * alpha


def with_modes(p: Array, modes: Modes, free: tuple[bool, bool]) -> tuple[Array, float, float]:
    """Packed parameters with friction signed by direction, and free flags; a sticking pendulum is not free."""
    out = p.copy()
    for i in range(2):
        out[FA + i] = abs(p[FA + i]) * (-1.0 if modes[i] == BACKWARD else 1.0)
    free_a, free_b = (float(free[i] and not (p[FA + i] != 0.0 and modes[i] == STUCK)) for i in range(2))
    return out, free_a, free_b


def modes_at(y: Array, phase: Array, p: Array, free: tuple[bool, bool], leaving: int | None = None) -> Modes:
    """Modes that friction permits at an instant.

    A pendulum with speed slides. For pendulums at rest on the rotor, all combinations are tried, sticking ones first.
    The result is the first consistent combination: torques of sticking pendulums are within their limits, and sliding
    pendulums accelerate in their direction. The sliding of one pendulum changes the torque on the other by at most the
    fraction S²/(J M_S), so both must be considered together.

    Args:
        y: state, shape (8,), with θ̇ exactly 0 for a pendulum at rest on the rotor.
        phase: ψ (rad), ω (rad/s), α (rad/s²).
        p: packed parameters, friction not negative.
        free: which pendulums are released.
        leaving: pendulum whose sticking has just ended. Its torque is at the limit, where rounding would decide.
    Raises:
        NotConverged: the state is not finite.
    """
    if not np.all(np.isfinite(y)):
        raise NotConverged(f"friction: no mode fits a state that is not finite: {y}")
    psi, omega, alpha = (float(v) for v in phase)
    choices: list[tuple[int, ...]] = []
    for i in range(2):
        if not free[i] or p[FA + i] == 0.0:
            choices.append((STUCK,))
        elif y[6 + i] != 0.0:
            choices.append((FORWARD if y[6 + i] > 0 else BACKWARD,))
        else:
            choices.append((FORWARD, BACKWARD) if i == leaving else (STUCK, FORWARD, BACKWARD))
    out, best, least = np.empty(8), (STUCK, STUCK), np.inf
    pairs = [(a, b) for a, b in product(choices[0], choices[1])]
    for modes in sorted(pairs, key=lambda m: abs(m[0]) + abs(m[1])):
        packed, free_a, free_b = with_modes(p, modes, free)
        worst = 0.0
        for i in range(2):
            if len(choices[i]) == 1:
                continue
            limit = abs(p[FA + i]) * omega**2
            torque = needed_torque(i, y, psi, omega, alpha, packed, free_a, free_b, out)
            # out contains the rates: a slide must accelerate in its direction
            violation = abs(torque) - limit if modes[i] == STUCK else -modes[i] * out[6 + i] * p[JA + i]
            worst = max(worst, violation)
        if worst <= 0.0:
            return modes
        if worst < least:
            best, least = modes, worst
    return best  # smallest contradiction: rounding at the border between two modes
