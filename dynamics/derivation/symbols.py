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
M_D: Symbol = sp.Symbol("M_D", positive=True)
M_P: Symbol = sp.Symbol("M_P", positive=True)
P_3: Symbol = sp.Symbol("P_3", positive=True)
M_A: Symbol = sp.Symbol("M_A", positive=True)
R_A: Symbol = sp.Symbol("R_A", positive=True)
M_B: Symbol = sp.Symbol("M_B", positive=True)
R_B: Symbol = sp.Symbol("R_B", positive=True)
k1: Symbol = sp.Symbol("k_1", real=True)
k2: Symbol = sp.Symbol("k_2", real=True)
c1: Symbol = sp.Symbol("c_1", real=True)
c2: Symbol = sp.Symbol("c_2", real=True)
c3: Symbol = sp.Symbol("c_3", real=True)
c4: Symbol = sp.Symbol("c_4", real=True)
g: Symbol = sp.Symbol("g", real=True)
# Shift of the pendulums' pivot (m), and the fraction of its imbalance that brass weights compensate (1 or 0)
R_C: Symbol = sp.Symbol("R_C", real=True)
compensated: Symbol = sp.Symbol("chi", real=True)
# Dry friction: arm (m) and sign of the sliding, +1 for θ̇ > 0. Balls: radius (m), inertia over m r² (0: a pendulum)
h_A: Symbol = sp.Symbol("h_A", real=True)
h_B: Symbol = sp.Symbol("h_B", real=True)
sign_A: Symbol = sp.Symbol("s_A", real=True)
sign_B: Symbol = sp.Symbol("s_B", real=True)
r_A: Symbol = sp.Symbol("r_A", real=True)
r_B: Symbol = sp.Symbol("r_B", real=True)
kappa_A: Symbol = sp.Symbol("kappa_A", real=True)
kappa_B: Symbol = sp.Symbol("kappa_B", real=True)
# The rotor's phase (rad), speed (rad/s), acceleration (rad/s²): given functions of time
psi: Symbol = sp.Symbol("psi", real=True)
omega: Symbol = sp.Symbol("omega", real=True)
alpha: Symbol = sp.Symbol("alpha", real=True)

# Disk centre, space-fixed (x, y) and rotating with the rotor (Y1, Y2), in m; pendulums relative to the rotor, in rad
x: Symbol = sp.Symbol("x", real=True)
y: Symbol = sp.Symbol("y", real=True)
Y1: Symbol = sp.Symbol("Y_1", real=True)
Y2: Symbol = sp.Symbol("Y_2", real=True)
theta3: Symbol = sp.Symbol(r"\theta_3", real=True)
theta4: Symbol = sp.Symbol(r"\theta_4", real=True)
dx: Symbol = sp.Symbol(r"\dot{x}", real=True)
dy: Symbol = sp.Symbol(r"\dot{y}", real=True)
dY1: Symbol = sp.Symbol(r"\dot{Y}_1", real=True)
dY2: Symbol = sp.Symbol(r"\dot{Y}_2", real=True)
dtheta3: Symbol = sp.Symbol(r"\dot{\theta}_3", real=True)
dtheta4: Symbol = sp.Symbol(r"\dot{\theta}_4", real=True)
ddx: Symbol = sp.Symbol(r"\ddot{x}", real=True)
ddy: Symbol = sp.Symbol(r"\ddot{y}", real=True)
ddY1: Symbol = sp.Symbol(r"\ddot{Y}_1", real=True)
ddY2: Symbol = sp.Symbol(r"\ddot{Y}_2", real=True)
ddtheta3: Symbol = sp.Symbol(r"\ddot{\theta}_3", real=True)
ddtheta4: Symbol = sp.Symbol(r"\ddot{\theta}_4", real=True)

# Sums of several of the above
M_S: Symbol = sp.Symbol("M_S", positive=True)
S_A: Symbol = sp.Symbol("S_A", positive=True)
S_B: Symbol = sp.Symbol("S_B", positive=True)
S_P: Symbol = sp.Symbol("S_P", positive=True)

RIG: tuple[Symbol, ...] = (
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
PHASE: tuple[Symbol, ...] = (psi, omega, alpha)

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
