"""Multipliers of the balanced state by numpy and scipy alone, from the linear equations in docs/theory/stability.md.

Nothing of the project's dynamics is used but the rig's numbers: small motions over one whole revolution by scipy's
DOP853, many points at a time, eigenvalues by numpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dynamics.equations.parameters import RotorParameters

Array = NDArray[np.floating]
_TOLERANCE = 3e-14  # relative, of a step
_AT_A_TIME = 256


@dataclass(frozen=True)
class LinearRotor:
    """The balanced state at many points of the plane Ω × K, time counted in radians of a turn.

    Attributes:
        kappa, gamma: k/(M_S ω²) and c/(M_S ω) along x and y, shape (points, 2).
        share: S_i²/(J_i M_S) of both pendulums, (2,).
        delta: c_i/(J_i ω), shape (points, 2).
        theta: balanced angles, rad, (2,).
    """

    kappa: Array
    gamma: Array
    share: Array
    delta: Array
    theta: Array

    @classmethod
    def of(cls, rig: RotorParameters, speed_ratio: Array, stiffness_ratio: Array) -> LinearRotor:
        """Points of a rig's plane, each of shape (points,)."""
        a, b = rig.a, rig.b
        mass = rig.rotor_mass_kg + rig.imbalance_mass_kg + a.mass_kg + b.mass_kg
        omega = speed_ratio * math.sqrt(rig.k1_N_per_m / mass)
        k = np.column_stack([np.full(len(omega), rig.k1_N_per_m), rig.k1_N_per_m * stiffness_ratio])
        c = 2 * np.array([rig.zeta1, rig.zeta2]) * np.sqrt(k * mass)
        arms = np.array([a.mass_kg * a.length_m, b.mass_kg * b.length_m])
        inertia = np.array([a.mass_kg * a.length_m**2, b.mass_kg * b.length_m**2])
        loss = np.array([a.damping_Nms_per_rad, b.damping_Nms_per_rad])
        return cls(
            k / (mass * omega[:, None] ** 2),
            c / (mass * omega[:, None]),
            arms**2 / (inertia * mass),
            loss / (inertia * omega[:, None]),
            _balanced(arms, rig.imbalance_mass_kg * rig.imbalance_radius_m),
        )

    def rates(self, phase: float) -> Array:
        """A(ψ) of the state (x, y, l1 θ3, l2 θ4, and their rates), l_i = S_i/M_S, shape (points, 8, 8)."""
        phi = phase + self.theta
        e = np.array([np.cos(phi), np.sin(phi)]).T  # of each pendulum
        n = np.array([np.sin(phi), -np.cos(phi)]).T
        points = len(self.kappa)
        push = np.zeros((points, 2, 8))  # W⁻¹ q'' / M_S
        for d in (0, 1):
            push[:, d, d], push[:, d, 4 + d] = -self.kappa[:, d], -self.gamma[:, d]
        for i in (0, 1):
            push[:, :, 2 + i] = -n[i]
            push[:, :, 6 + i] = 2 * e[i] - self.delta[:, i, None] * n[i]
        mass = np.eye(2) - (self.share[:, None] * n).T @ n
        pull = np.linalg.inv(mass) @ push
        found = np.zeros((points, 8, 8))
        found[:, :4, 4:] = np.eye(4)
        found[:, 4:6] = pull
        for i in (0, 1):
            found[:, 6 + i] = self.share[i] * (n[i] @ pull)
            found[:, 6 + i, 6 + i] -= self.delta[:, i]
        return found


def multipliers(rig: RotorParameters, speed_ratio: Array, stiffness_ratio: Array) -> NDArray[np.complexfloating]:
    """All eight multipliers over one revolution, the largest modulus first, shape (points, 8)."""
    found = np.empty((len(speed_ratio), 8), complex)
    order = np.argsort(speed_ratio)
    for start in range(0, len(order), _AT_A_TIME):
        some = order[start : start + _AT_A_TIME]
        found[some] = np.linalg.eigvals(_monodromy(LinearRotor.of(rig, speed_ratio[some], stiffness_ratio[some])))
    return np.take_along_axis(found, np.argsort(-np.abs(found), axis=1), 1)


def _monodromy(rotor: LinearRotor) -> Array:
    points = len(rotor.kappa)

    def rate(phase: float, state: Array) -> Array:
        return (rotor.rates(phase) @ state.reshape(points, 8, 8)).ravel()

    start = np.tile(np.eye(8), (points, 1, 1)).ravel()
    run: Any = solve_ivp(rate, (0.0, 2 * math.pi), start, "DOP853", t_eval=[2 * math.pi], rtol=_TOLERANCE, atol=1e-15)
    return run.y[:, -1].reshape(points, 8, 8)


def _balanced(arms: Array, imbalance: float) -> Array:
    """Angles at which both first mass moments and the imbalance add up to nothing, θ3 in 0 … π."""
    a, b = arms
    cosine = (b**2 - a**2 - imbalance**2) / (2 * a * imbalance)
    theta3 = math.acos(cosine)
    rest = -imbalance - a * complex(cosine, math.sin(theta3))
    return np.array([theta3, math.atan2(rest.imag, rest.real)])
