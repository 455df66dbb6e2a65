"""The independent rig with dry friction: slides and sticks, each a stretch of scipy's DOP853 with events between.

Point masses, the mass matrix of their Lagrangian, a torque −sign(θ̇) (M + F φ̇²) on each pendulum that slides and none of
its own on one that sticks. Shares no line with the dynamics and identification packages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

_LEAST = 1e-9  # rad/s with which a slide begins


@dataclass(frozen=True)
class Dry:
    """Friction of A and B: a torque at any speed, N m, and one with the contact force, kg m²."""

    torque_Nm: tuple[float, float] = (0.0, 0.0)
    contact_kg_m2: tuple[float, float] = (0.0, 0.0)

    def limit(self, i: int, speed: float) -> float:
        return self.torque_Nm[i] + self.contact_kg_m2[i] * speed**2


@njit(cache=True)
def _slope(t, y, p, dry, mode):
    """With p as in independent_rig: mass, k1, k2, c1, c2, SA, SB, SP, JA, JB, cA, cB, speed,
    phase; mode −1, 0 (sticks), 1."""
    out, m, f = np.empty(8), np.zeros((4, 4)), np.zeros(4)
    speed, psi = p[12], p[13] + p[12] * t
    m[0, 0] = m[1, 1] = p[0]
    f[0] = -p[1] * y[0] - p[3] * y[4] + p[7] * speed**2 * np.cos(psi)
    f[1] = -p[2] * y[1] - p[4] * y[5] + p[7] * speed**2 * np.sin(psi)
    for i in range(2):
        s, phi, rate = p[5 + i], psi + y[2 + i], speed + y[6 + i]
        f[0] += s * rate**2 * np.cos(phi)
        f[1] += s * rate**2 * np.sin(phi)
        m[2 + i, 2 + i] = p[8 + i]
        if mode[i] == 0:  # its angle does not change: no acceleration of its own, and none asked of the disk
            continue
        m[0, 2 + i] = m[2 + i, 0] = -s * np.sin(phi)
        m[1, 2 + i] = m[2 + i, 1] = s * np.cos(phi)
        f[2 + i] = -p[10 + i] * y[6 + i] - mode[i] * (dry[i] + dry[2 + i] * rate**2)
    out[:4] = y[4:]
    out[4:] = np.linalg.solve(m, f)
    return out


@njit(cache=True)
def _holding(t, y, p, dry, mode, i):
    """The torque that keeps pendulum i where it is, N m."""
    away = _slope(t, y, p, dry, mode)
    phi = p[13] + p[12] * t + y[2 + i]
    return p[5 + i] * (np.sin(phi) * away[4] - np.cos(phi) * away[5])


def swings(start: np.ndarray, times: np.ndarray, p: np.ndarray, friction: Dry, most: int = 20_000) -> np.ndarray:
    """Both pendulums free from `start` at times[0]; states at the times, shape (n, 8)."""
    dry = np.array([*friction.torque_Nm, *friction.contact_kg_m2])
    out, y, t, done = np.empty((len(times), 8)), np.array(start, float), float(times[0]), 0
    limit = [friction.limit(i, p[12]) for i in range(2)]
    mode = np.array([int(np.sign(v)) if abs(v) > _LEAST else 0 for v in y[6:]])

    def excess(i: int, t: float, y: np.ndarray) -> float:
        return abs(_holding(t, y, p, dry, np.where(np.arange(2) == i, 0, mode), i)) - limit[i]

    def begin(i: int) -> None:
        if excess(i, t, y) > 0 or not limit[i]:
            mode[i] = 1 if _holding(t, y, p, dry, np.where(np.arange(2) == i, 0, mode), i) > 0 else -1
            y[6 + i] = mode[i] * _LEAST

    for i in range(2):
        if mode[i] == 0:
            begin(i)
    for _ in range(most):
        events: list[Callable[..., float]] = []
        for i in range(2):
            if not limit[i]:
                mode[i] = mode[i] or 1  # without friction there is nothing to switch
                continue
            event = (lambda t, y, i=i: excess(i, t, y)) if mode[i] == 0 else (lambda t, y, i=i: mode[i] * y[6 + i])
            event.terminal, event.direction = True, 1.0 if mode[i] == 0 else -1.0  # type: ignore[attr-defined]
            events.append(event)
        found = solve_ivp(lambda t, y: _slope(t, y, p, dry, mode), (t, times[-1]), y, "DOP853", rtol=1e-9, atol=1e-11,
                          dense_output=True, events=events or None)  # fmt: skip
        t, y = float(found.t[-1]), found.y[:, -1].copy()
        upto = int(np.searchsorted(times, t, side="right"))
        if upto > done:
            out[done:upto] = found.sol(times[done:upto]).T
            done = upto
        if found.status != 1:
            return out
        for i in range(2):
            if limit[i] and mode[i] != 0 and mode[i] * y[6 + i] < 2 * _LEAST / 3:
                y[6 + i], mode[i] = 0.0, 0
                begin(i)
            elif limit[i] and mode[i] == 0:
                begin(i) if excess(i, t, y) > -1e-12 else None
                if mode[i] == 0 and excess(i, t, y) > -1e-9:
                    mode[i] = 1 if _holding(t, y, p, dry, mode, i) > 0 else -1
                    y[6 + i] = mode[i] * _LEAST
    raise AssertionError("friction switches without end")
