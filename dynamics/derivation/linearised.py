"""Small motions about a state, and the states at rest in the rotating frame.

    [M] ÿ + [D + G] ẏ + [K + N] y = 0
contains the derivatives of the equations with respect to accelerations, rates and coordinates. On an isotropic
suspension the matrices in the rotating frame are constant. Otherwise they contain cos 2ψ and sin 2ψ, and their period
is half a revolution.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dynamics.derivation import symbols as s
from dynamics.derivation.lagrange import LagrangeEquations, rotating_frame_equations
from dynamics.derivation.symbols import Expr, Matrix

ISOTROPIC: dict[Expr, Expr] = {s.k2: s.k1, s.c2: s.c1}


@dataclass(frozen=True)
class LinearMotion:
    """Matrices of the motion about a state, shape (4, 4) each.

    Attributes:
        inertia: [M].
        damping: [D + G], damping and gyroscopic terms.
        stiffness: [K + N], elastic and non-conservative (circulatory) terms.
    """

    inertia: Matrix
    damping: Matrix
    stiffness: Matrix

    def subs(self, values: Mapping[Expr, Any]) -> LinearMotion:
        """The matrices with substituted values, in normal form."""
        return LinearMotion(
            *(m.subs(values).applyfunc(s.normal_form) for m in (self.inertia, self.damping, self.stiffness))
        )

    def in_moments(self) -> LinearMotion:
        """The matrices written with M_S, S_A, S_B, S_P."""
        return LinearMotion(*(m.applyfunc(s.in_moments) for m in (self.inertia, self.damping, self.stiffness)))


def linearised(residual: Matrix, equations: LagrangeEquations) -> LinearMotion:
    """Derivatives of four equations of motion at a general state. Coordinates, rates, accelerations stay symbols.

    Args:
        residual: shape (4, 1), zero along a motion.
        equations: source of the residual's coordinates, rates and accelerations.
    """
    return LinearMotion(
        residual.jacobian(list(equations.accelerations)),
        residual.jacobian(list(equations.rates)),
        residual.jacobian(list(equations.coordinates)),
    )


def at_rest(equations: LagrangeEquations) -> dict[Expr, int]:
    """Substitution of zero for rates and accelerations: a state at rest in the equations' frame."""
    return dict.fromkeys((*equations.rates, *equations.accelerations), 0)


@functools.cache
def singular_point_matrices() -> LinearMotion:
    """Motion about a state (Y1, Y2, θ3, θ4) at rest in the rotating frame, plain rig, constant speed, k1 ≠ k2.

    Type I is Y1 = Y2 = 0. After substitution of `ISOTROPIC` the matrices hold for all three types, and ψ cancels.
    """
    equations = rotating_frame_equations()
    return linearised(equations.residual, equations).subs(at_rest(equations) | s.PLAIN).in_moments()


@functools.cache
def singular_point_equations() -> Matrix:
    """Conditions of a state at rest in the rotating frame, shape (4, 1), = 0; plain rig, constant speed.

    With unequal springs or dampers the first two contain ψ, so only Y1 = Y2 = 0 satisfies them at all times.
    """
    equations = rotating_frame_equations()
    return equations.residual.subs(at_rest(equations) | s.PLAIN).applyfunc(s.in_moments)
