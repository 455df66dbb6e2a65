"""Steady motion of the locked rig with hardening springs or amplitude-dependent damping: harmonic balance by direction.

With both pendulums locked, x and y are uncoupled. Each obeys
    M q̈ + c q̇ (1 + Q |q̇|) + k u (1 + H u²) = F(ψ),    u = q − b(ψ),

where b is the rest position of the spring. Over one revolution q is a Fourier series. The forces are evaluated at N
phases and balanced order by order with Newton's method. N is doubled until the result does not change. The nonlinear
terms are increased in steps, so that the result is the motion that continues the linear rig's motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.errors import OutsideDomain

_MIN_PHASES, _MAX_PHASES = 32, 256  # phases of a revolution
_SHARES = (0.25, 0.5, 0.75, 1.0)  # fractions of the nonlinear terms
_ITERATIONS, _SETTLED, _ACCURATE = 30, 1e-13, 1e-7  # limits of Newton's step and of the change with N, relative


@dataclass(frozen=True)
class Direction:
    """One direction of the suspension.

    Attributes:
        mass, c, k: mass, damping, stiffness: kg, N s/m, N/m.
        hardening, growth: H, 1/m², and Q, s/m.
    """

    mass: float
    c: float
    k: float
    hardening: float
    growth: float


def whirl_orders(own: Direction, speed_rad_s: float, force: complex, rest: complex, constant: float) -> Complex:
    """Complex amplitudes q_k of q = Re Σ q_k e^{ikψ}, order 0 first.

    Args:
        force: complex amplitude of F, N: Re(force e^{iψ}).
        rest: complex amplitude of b, m: Re(rest e^{iψ}).
        constant: constant force, N.
    Raises:
        OutsideDomain: the linear motion cannot be continued, for example near a resonance bent over by the spring.
    """
    start = np.zeros(_MIN_PHASES // 2 + 1, np.complex128)
    start[0] = constant / own.k
    start[1] = (force + own.k * rest) / (own.k - own.mass * speed_rad_s**2 + 1j * speed_rad_s * own.c)
    for share in _SHARES:
        start = _balanced(own, share, speed_rad_s, (force, rest, constant), start)
    count, moved = _MIN_PHASES, np.inf
    while count < _MAX_PHASES:
        count *= 2
        finer = np.zeros(count // 2 + 1, np.complex128)
        finer[: len(start)] = start
        finer = _balanced(own, 1.0, speed_rad_s, (force, rest, constant), finer)
        moved = float(np.max(np.abs(finer[: len(start)] - start)))
        start = finer
        if moved <= _ACCURATE * float(np.max(np.abs(finer))):
            return finer
    raise OutsideDomain(
        f"at {speed_rad_s:.6g} rad/s the locked orbit still changes by {moved:.2g} m with {_MAX_PHASES} phases"
    )


def _balanced(
    own: Direction, share: float, speed: float, drive: tuple[complex, complex, float], start: Complex
) -> Complex:
    """Solution by Newton's method, with the number of phases that corresponds to the orders of the start."""
    n = 2 * (len(start) - 1)
    phase, orders = 2 * np.pi * np.arange(n) / n, np.arange(1, n // 2)
    force, rest, constant = drive
    h, g = share * own.hardening, share * own.growth
    # columns: 1, cos kψ, sin kψ; the highest order is kept at 0
    value: Array = np.column_stack([np.ones(n), np.cos(np.outer(phase, orders)), np.sin(np.outer(phase, orders))])
    degree: Array = np.concatenate([np.zeros(1), orders, orders]).astype(np.float64)
    m = len(orders)
    slope: Array = np.column_stack([np.zeros(n), -orders * value[:, 1 + m :], orders * value[:, 1 : 1 + m]]) * speed
    transform: Array = value.T / np.sum(value**2, axis=0)[:, None]
    turn = np.exp(1j * phase)
    pushed: Array = transform @ ((force * turn).real + constant)
    resting: Array = (rest * turn).real
    c: Array = np.concatenate([start[:-1].real, -start[1:-1].imag])
    inertia = -own.mass * (speed * degree) ** 2
    for _ in range(_ITERATIONS):
        u, v = value @ c - resting, slope @ c
        pull = own.k * u * (1 + h * u * u) + own.c * v * (1 + g * np.abs(v))
        residual = inertia * c + transform @ pull - pushed
        by = own.k * (1 + 3 * h * u * u)[:, None] * value + own.c * (1 + 2 * g * np.abs(v))[:, None] * slope
        step = np.asarray(np.linalg.solve(np.diag(inertia) + transform @ by, residual), np.float64)
        c -= step
        if not np.all(np.isfinite(c)):
            break
        if float(np.max(np.abs(step))) <= _SETTLED * float(np.max(np.abs(c))) + 1e-300:
            return np.r_[c[0], c[1 : 1 + m] - 1j * c[1 + m :], 0.0]
    raise OutsideDomain(
        f"at {speed:.6g} rad/s the locked rotor has no steady motion that continues that of a linear suspension: the "
        "speed is near a resonance bent over by the springs; expected weaker terms or another speed"
    )
