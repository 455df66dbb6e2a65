"""The source's equations as printed: R. Horváth, Passive Pendulum Balancer for Rotor Systems, Auburn, 2006.

Written with the derivation's symbols: the source's Θ1, Θ2 of its chapters 3 and 4 are Y1, Y2 (they rotate with the
rotor), its Θ3, Θ4 are θ3, θ4, its Y_iE are the same symbols at rest, its S_A R_BA is S_A R_A. Misprints are kept.
`dynamics.derivation.comparison` compares them with the derivation. No other module may use this one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dynamics.derivation.symbols import (
    M_P,
    M_S,
    P_3,
    R_A,
    R_B,
    S_A,
    S_B,
    S_P,
    Y1,
    Y2,
    Expr,
    Matrix,
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

sin: Callable[[Expr], Expr] = sp.sin
cos: Callable[[Expr], Expr] = sp.cos
Half: Expr = sp.Rational(1, 2)
# M_D + M_BA + M_BB, which several equations separate from M_P; the disk's spin energy ¼ M_D R_D² ω²
M_REST = M_S - M_P
SPIN = sp.Symbol("M_D R_D^2 / 2")

# Chapters 3 and 4 print one kinetic energy, (3-9) = (4-2)
KINETIC = (
    Half
    * omega**2
    * (
        S_A * (R_A + 2 * Y1 * cos(theta3) + 2 * Y2 * sin(theta3))
        + S_B * (R_B + 2 * Y1 * cos(theta4) + 2 * Y2 * sin(theta4))
        + S_P * (P_3 + 2 * Y1)
        + M_S * (Y1**2 + Y2**2)
        + SPIN
    )
    + omega
    * (
        M_S * (dY2 * Y1 - dY1 * Y2)
        + S_A * Y2 * sin(theta3) * dtheta3
        + S_B * Y1 * cos(theta4) * dtheta4
        + S_A * R_A * dtheta3
        + S_P * dY2
        + S_A * dtheta3 * Y1 * cos(theta3)
        - S_B * dY1 * sin(theta4)
        + S_B * Y2 * sin(theta4) * dtheta4
        + S_A * dY2 * cos(theta3)
        + S_B * dY2 * cos(theta4)
        + S_B * R_B * dtheta4
        - S_A * dY1 * sin(theta3)
    )
    + Half * M_S * (dY1**2 + dY2**2)
    + Half * S_A * R_A * dtheta3**2
    + Half * S_B * R_B * dtheta4**2
    + S_A * dY2 * dtheta3 * cos(theta3)
    + S_B * dY2 * dtheta4 * cos(theta4)
    - S_B * dY1 * dtheta4 * sin(theta4)
    - S_A * dY1 * dtheta3 * sin(theta3)
)
POTENTIAL_ISOTROPIC = Half * k1 * (Y1**2 + Y2**2)
DISSIPATION_ISOTROPIC = (
    Half * c1 * (dY1**2 + dY2**2)
    - c1 * omega * (dY1 * Y2 - dY2 * Y1)
    + Half * c1 * omega**2 * (Y1**2 + Y2**2)
    + Half * (c3 * dtheta3**2 + c4 * dtheta4**2)
)
POTENTIAL = Half * k1 * (cos(psi) * Y1 - sin(psi) * Y2) ** 2 + Half * k2 * (sin(psi) * Y1 + cos(psi) * Y2) ** 2
# ẋ and ẏ without their Θ̇1 part, as written in (4-4), (4-6) and (4-7)
ALONG_X = -cos(psi) * omega * Y2 - sin(psi) * (dY2 + omega * Y1)
ALONG_Y = -sin(psi) * omega * Y2 + cos(psi) * (dY2 + omega * Y1)
DISSIPATION = (
    Half * dY1**2 * (c1 * cos(psi) ** 2 + c2 * sin(psi) ** 2)
    + dY1 * (c1 * ALONG_X * cos(psi) + c2 * ALONG_Y * sin(psi))
    + Half * c1 * ALONG_X**2
    + Half * c3 * dtheta3**2
    + Half * c2 * ALONG_Y**2
    + Half * c4 * dtheta4**2
)


def _push_1(theta: Expr, rate: Expr, acceleration: Expr) -> Expr:
    return 2 * omega * cos(theta) * rate + sin(theta) * acceleration + omega**2 * cos(theta) + cos(theta) * rate**2


def _push_2(theta: Expr, rate: Expr, acceleration: Expr, sign: int) -> Expr:
    turned = sign * cos(theta) * acceleration
    return 2 * omega * sin(theta) * rate + turned + omega**2 * sin(theta) + sin(theta) * rate**2


def _pendulum(S: Expr, R: Expr, theta: Expr, rate: Expr, acceleration: Expr, c: Expr) -> Expr:
    inside = (
        -sin(theta) * ddY1
        + R * acceleration
        + cos(theta) * ddY2
        + 2 * sin(theta) * omega * dY2
        + 2 * cos(theta) * omega * dY1
        - omega**2 * cos(theta) * Y2
        + omega**2 * sin(theta) * Y1
    )
    return S * inside + c * rate


# (3-15) = (4-8) and (3-16) = (4-9)
PENDULUM_A = _pendulum(S_A, R_A, theta3, dtheta3, ddtheta3, c3)
PENDULUM_B = _pendulum(S_B, R_B, theta4, dtheta4, ddtheta4, c4)
EQUATION_3_13 = (
    -S_A * _push_1(theta3, dtheta3, ddtheta3)
    - S_B * _push_1(theta4, dtheta4, ddtheta4)
    - M_P * (omega**2 * Y1 - ddY1 + 2 * omega * dY2 + omega**2 * P_3)
    + M_REST * ddY1
    + c1 * (dY1 - omega * Y2)
    + k1 * Y1
    - M_REST * (2 * omega * dY2 + omega**2 * Y1)
)
EQUATION_3_14 = (
    -S_A * _push_2(theta3, dtheta3, ddtheta3, -1)
    - S_B * _push_2(theta4, dtheta4, ddtheta4, -1)
    - M_P * (omega**2 * Y2 - ddY2 - 2 * omega * dY1)
    + M_REST * ddY2
    + c1 * (dY2 + omega * Y1)
    + k1 * Y2
    + M_REST * (2 * omega * dY1 - omega**2 * Y2)
)
EQUATION_4_6 = (
    -S_A * _push_1(theta3, dtheta3, ddtheta3)
    - S_B * _push_1(theta4, dtheta4, ddtheta4)
    - M_P * (omega**2 * Y1 - ddY1 + 2 * omega * dY2 + omega**2 * P_3)
    + M_REST * ddY1
    + c1 * cos(psi) * ALONG_X
    + c2 * sin(psi) * ALONG_Y
    + k1 * cos(psi) * (cos(psi) * Y1 - sin(psi) * Y2)
    + k2 * sin(psi) * (sin(psi) * Y1 + cos(psi) * Y2)
    - M_REST * (2 * omega * dY2 + omega**2 * Y1)
)
EQUATION_4_7 = (
    -S_A * _push_2(theta3, dtheta3, ddtheta3, 1)
    - S_B * _push_2(theta4, dtheta4, ddtheta4, -1)
    - M_P * (omega**2 * Y2 - ddY2 + 2 * omega * dY1)
    + M_REST * ddY2
    + c1 * sin(psi) * (-sin(psi) * omega * Y2 - cos(psi) * (dY2 + omega * Y1))
    + c2 * cos(psi) * (-cos(psi) * omega * Y2 + cos(psi) * (dY2 + omega * Y1))
    + k1 * sin(psi) * (sin(psi) * Y1 - cos(psi) * Y2)
    + k2 * cos(psi) * (cos(psi) * Y1 + cos(psi) * Y2)
    + M_REST * (2 * omega * dY1 - omega**2 * Y2)
)

# Algebraic equations of the singular points
_MOMENTS_1 = Y1 * M_S + S_A * cos(theta3) + S_B * cos(theta4)
EQUATION_3_17 = -(omega**2) * _MOMENTS_1 - omega * c1 * Y2 + k1 * Y1
EQUATION_3_18 = -(omega**2) * (Y2 * M_S + S_A * sin(theta3) + S_B * sin(theta4)) + omega * c1 * Y1 + k1 * Y2
TORQUE_A = S_A * (Y1 * sin(theta3) - Y2 * cos(theta3)) * omega**2
TORQUE_B = S_B * (Y1 * sin(theta4) - Y2 * cos(theta4)) * omega**2
EQUATION_4_10 = (
    -(omega**2) * _MOMENTS_1
    + omega * c2 * (cos(psi) * Y1 - sin(psi) * Y2) * sin(psi)
    - omega * c1 * (cos(psi) * Y2 + sin(psi) * Y1) * cos(psi)
    + k1 * (cos(psi) * Y1 - sin(psi) * Y2) * cos(psi)
    + k2 * (sin(psi) * Y1 + cos(psi) * Y2) * sin(psi)
)
EQUATION_4_11 = (
    -(omega**2) * (Y1 * M_S + S_A * sin(theta3) + S_B * sin(theta4))
    + omega * c1 * (sin(psi) * Y1 + cos(psi) * Y2) * sin(psi)
    + omega * c2 * (cos(psi) * Y1 + sin(psi) * Y2) * cos(psi)
    + k1 * (cos(psi) * Y2 - sin(psi) * Y1) * cos(psi)
    + k2 * (sin(psi) * Y2 + cos(psi) * Y1) * sin(psi)
)


def balanced_angle_arguments() -> tuple[tuple[Expr, Expr], tuple[Expr, Expr]]:
    """(3-21), (3-22): the two arguments of the four-quadrant arc tangent for θ3 and for θ4."""
    A, B = (S_A + S_B - S_P) * (S_A + S_B + S_P), (S_A - S_B - S_P) * (S_A - S_B + S_P)
    root = sp.sqrt(-A * B)
    first = (-root / (2 * S_P * S_A), -(S_A**2 - S_B**2 + S_P**2) / (2 * S_P * S_A))
    return first, (root / (S_P * S_B), (S_A**2 - S_B**2 - S_P**2) / (S_P * S_B))


# (3-27) = (4-15)
INERTIA = sp.Matrix(
    [
        [M_S, 0, -S_A * sin(theta3), -S_B * sin(theta4)],
        [0, M_S, S_A * cos(theta3), S_B * cos(theta4)],
        [-S_A * sin(theta3), S_A * cos(theta3), S_A * R_A, 0],
        [-S_B * sin(theta3), S_B * cos(theta4), 0, S_B * R_B],
    ]
)


def _pendulum_cells(disk: Sequence[Sequence[Expr]], last: Sequence[Expr], rate: bool) -> Matrix:
    """Cells common to chapters 3 and 4: pendulum columns and rows of [D + G] (rate) or [K + N]."""
    if rate:
        right = (
            (-2 * omega * cos(theta3), -2 * omega * cos(theta4)),
            (-2 * omega * sin(theta3), -2 * omega * sin(theta4)),
        )
        below = (
            (2 * omega * cos(theta3), -2 * omega * sin(theta3)),
            (2 * omega * cos(theta4), -2 * omega * sin(theta4)),
        )
    else:
        right = (
            (omega**2 * sin(theta3), omega**2 * sin(theta4)),
            (-(omega**2) * cos(theta3), -(omega**2) * cos(theta4)),
        )
        below = (
            (omega**2 * sin(theta3), -(omega**2) * cos(theta4)),
            (omega**2 * sin(theta4), -(omega**2) * cos(theta4)),
        )
    upper = [[*disk[i], S_A * right[i][0], S_B * right[i][1]] for i in range(2)]
    lower = [[S * below[i][0], S * below[i][1], 0, 0] for i, S in enumerate((S_A, S_B))]
    lower[0][2], lower[1][3] = last
    return sp.Matrix(upper + lower)


_KN = (
    S_A * (Y2 * sin(theta3) + Y1 * cos(theta3)),
    S_B * (Y2 * sin(theta4) + Y1 * cos(theta4)),
)
_SIGMA = sin(psi) * cos(psi)
_CHI_1, _CHI_2 = c1 * cos(psi) ** 2 + c2 * sin(psi) ** 2, c1 * sin(psi) ** 2 + c2 * cos(psi) ** 2
_KAPPA_1, _KAPPA_2 = k1 * cos(psi) ** 2 + k2 * sin(psi) ** 2, k1 * sin(psi) ** 2 + k2 * cos(psi) ** 2
# (3-28), (3-29), (4-16), (4-17)
DAMPING_ISOTROPIC = _pendulum_cells([[c1, -2 * M_S * omega], [2 * M_S * omega, c1]], (c3, c4), True)
STIFFNESS_ISOTROPIC = _pendulum_cells(
    [[-M_S * omega**2 + k1, -omega * c1], [omega * c1, -M_S * omega**2 + k1]], _KN, False
)
DAMPING = _pendulum_cells(
    [
        [_CHI_2, -2 * M_S * omega + (c2 - c1) * _SIGMA],
        [2 * M_S * omega + (c2 - c1) * _SIGMA, _CHI_1],
    ],
    (c3, c4),
    True,
)
STIFFNESS = _pendulum_cells(
    [
        [-M_S * omega**2 + _KAPPA_1 + (c2 - c1) * _SIGMA, -omega * _CHI_1 - (k1 - k2) * _SIGMA],
        [omega * _CHI_2 - (k1 - k2) * _SIGMA, -M_S * omega**2 + _KAPPA_2 + (c1 - c2) * _SIGMA],
    ],
    _KN,
    False,
)
