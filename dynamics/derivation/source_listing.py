"""Scheme of the source's programs (its appendix B) in the derivation's symbols, with their misprints.

Motion: the expressions of the generated file for Θ̈1, Θ̈2, Θ̈3, Θ̈4, in the rotating frame, with rotor acceleration.
Matrix: the entries that the generating program writes to the inertia matrix.
"""

from __future__ import annotations

import functools

from dynamics.derivation.symbols import (
    M_P,
    M_S,
    P_3,
    R_A,
    R_B,
    S_A,
    S_B,
    Y1,
    Y2,
    Expr,
    Matrix,
    alpha,
    c1,
    c2,
    c3,
    c4,
    ddtheta3,
    ddtheta4,
    ddY1,
    ddY2,
    dtheta3,
    dtheta4,
    dY1,
    dY2,
    k1,
    k2,
    omega,
    psi,
    sp,
    theta3,
    theta4,
)

# The generated file computes the disk's accelerations first; at that point those of the pendulums are zero
NOT_YET_COMPUTED = {ddtheta3: sp.Integer(0), ddtheta4: sp.Integer(0)}


def _suspension() -> tuple[Expr, Expr]:
    s, c = sp.sin(psi), sp.cos(psi)
    first = (
        (c1 - c2) * s * c * omega * Y1
        - (c1 * c**2 + c2 * s**2) * dY1
        + (k1 - k2) * s * c * Y2
        + (c1 - c2) * s * c * dY2
        - (k1 * c**2 + k2 * s**2) * Y1
        + (c1 * c**2 + c2 * s**2) * omega * Y2
    )
    second = (
        (k1 - k2) * s * c * Y1
        - (c2 * c**2 + c1 * s**2) * omega * Y1
        + (c1 - c2) * s * c * dY1
        - (c1 * s**2 + c2 * c**2) * dY2
        - (k2 * c**2 + k1 * s**2) * Y2
        + (c2 - c1) * s * c * omega * Y2
    )
    return first, second


def residuals() -> Matrix:
    """The four assignments multiplied out to force and torque balances, shape (4, 1), = 0."""
    first, second = _suspension()
    first += M_S * (omega**2 * Y1 + alpha * Y2 + 2 * omega * dY2) + M_P * omega**2 * P_3
    second += M_S * (omega**2 * Y2 - alpha * Y1 - 2 * omega * dY1) - M_P * alpha * P_3
    rows: list[Expr] = []
    for S, R, theta, rate, acceleration, c in (
        (S_A, R_A, theta3, dtheta3, ddtheta3, c3),
        (S_B, R_B, theta4, dtheta4, ddtheta4, c4),
    ):
        sin, cos = sp.sin(theta), sp.cos(theta)
        first += S * (alpha * sin + cos * rate**2 + sin * acceleration + 2 * omega * cos * rate + omega**2 * cos)
        second += S * (omega**2 * sin + sin * rate**2 + 2 * omega * sin * rate - cos * acceleration - alpha * cos)
        torque = (
            2 * omega * dY1 * cos
            + alpha * Y2 * sin
            + 2 * omega * dY2 * sin
            + alpha * Y1 * cos
            - omega**2 * Y2 * cos
            + ddY2 * cos
            + R * alpha
            - sin * ddY1
            + omega**2 * Y1 * sin
        )
        rows.append(S * R * acceleration + S * torque + c * rate)
    return sp.Matrix([M_S * ddY1 - first, M_S * ddY2 - second, *rows])


@functools.cache
def kinetic_energy_of_pendulum_a_as_listed() -> Expr:
    """½ M_A v² with the position of pendulum A rotated by θ4, as in the generating program; α = 0."""
    a = sp.Matrix([Y1 + R_A * sp.cos(theta4), Y2 + R_A * sp.sin(theta4)])
    v = a.diff(Y1) * dY1 + a.diff(Y2) * dY2 + a.diff(theta4) * dtheta4 + omega * sp.Matrix([[0, -1], [1, 0]]) * a
    return S_A / R_A * v.dot(v) / 2


# Cell (1,4) of the inertia matrix is filled from cell (1,3)
CELL_1_4_AS_LISTED = -S_A * sp.sin(theta3)
