"""Symbols of the derivation: the rig's parameters, the rotor's phase, the coordinates, and the normal form of sums.

Names are those of docs/theory/equations_of_motion.md. Coordinates, rates and accelerations are plain symbols, not
functions of time. `dynamics.derivation.lagrange` defines which is the time derivative of which.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import sympy

sp: Any = sympy  # SymPy annotates only a part of its functions and methods
Expr: TypeAlias = Any
"""sympy.Expr"""
Matrix: TypeAlias = Any
"""sympy.Matrix"""
Symbol: TypeAlias = Any
"""sympy.Symbol"""

# Masses (kg), lengths (m), suspension (N/m, N s/m), damping of the pendulums (N m s/rad), gravity (m/s²)
M_D, M_P, P_3, M_A, R_A, M_B, R_B = sp.symbols("M_D M_P P_3 M_A R_A M_B R_B", positive=True)
k1, k2, c1, c2, c3, c4, g = sp.symbols("k_1 k_2 c_1 c_2 c_3 c_4 g", real=True)
# Shift of the pendulums' pivot (m), and the fraction of its imbalance that brass weights compensate (1 or 0)
R_C, compensated = sp.symbols("R_C chi", real=True)
# Dry friction: arm (m) and sign of the sliding, +1 for θ̇ > 0. Balls: radius (m), inertia over m r² (0: a pendulum)
h_A, h_B, sign_A, sign_B = sp.symbols("h_A h_B s_A s_B", real=True)
r_A, r_B, kappa_A, kappa_B = sp.symbols("r_A r_B kappa_A kappa_B", real=True)
# The rotor's phase (rad), speed (rad/s), acceleration (rad/s²): given functions of time
psi, omega, alpha = sp.symbols("psi omega alpha", real=True)

# Disk centre, space-fixed (x, y) and rotating with the rotor (Y1, Y2), in m; pendulums relative to the rotor, in rad
x, y, Y1, Y2, theta3, theta4 = sp.symbols(r"x y Y_1 Y_2 \theta_3 \theta_4", real=True)
dx, dy, dY1, dY2, dtheta3, dtheta4 = sp.symbols(
    r"\dot{x} \dot{y} \dot{Y}_1 \dot{Y}_2 \dot{\theta}_3 \dot{\theta}_4", real=True
)
ddx, ddy, ddY1, ddY2, ddtheta3, ddtheta4 = sp.symbols(
    r"\ddot{x} \ddot{y} \ddot{Y}_1 \ddot{Y}_2 \ddot{\theta}_3 \ddot{\theta}_4", real=True
)

# Sums of several of the above
M_S, S_A, S_B, S_P = sp.symbols("M_S S_A S_B S_P", positive=True)

RIG = (
    M_D,
    M_P,
    P_3,
    M_A,
    R_A,
    M_B,
    R_B,
    k1,
    k2,
    c1,
    c2,
    c3,
    c4,
    g,
    R_C,
    compensated,
    h_A,
    h_B,
    sign_A,
    sign_B,
    r_A,
    r_B,
    kappa_A,
    kappa_B,
)
PHASE = (psi, omega, alpha)

# Quantities that a plain rig does not have: pivot shift, gravity, dry friction, balls, rotor acceleration
PLAIN: dict[Expr, int] = dict.fromkeys((R_C, compensated, g, h_A, h_B, kappa_A, kappa_B, alpha), 0)


def normal_form(expression: Expr) -> Expr:
    """Expanded sum without sin² or higher powers of sines. It is zero exactly if the expression is zero.

    Args:
        expression: polynomial in the symbols and in sines and cosines of sums of the angles ψ, θ3, θ4.
    """
    expanded = sp.expand(sp.expand_trig(expression))
    while True:
        squares = [p for p in expanded.atoms(sp.Pow) if isinstance(p.base, sp.sin) and p.exp.is_Integer and p.exp > 1]
        if not squares:
            return expanded
        lowered = {
            p: (1 - sp.cos(p.base.args[0]) ** 2) ** (int(p.exp) // 2) * p.base ** (int(p.exp) % 2) for p in squares
        }
        expanded = sp.expand(expanded.xreplace(lowered))


def in_moments(expression: Expr) -> Expr:
    """Normal form written with M_S, S_A, S_B, S_P instead of M_D, M_A, M_B, P_3."""

    shorter = {M_D: M_S - M_P - M_A - M_B, M_A: S_A / R_A, M_B: S_B / R_B, P_3: S_P / M_P}
    return normal_form(expression.subs(M_D, shorter.pop(M_D)).subs(shorter))
