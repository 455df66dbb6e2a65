"""Numerical values of a scene for the derivation, and its accelerations to any number of digits."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from dynamics.derivation import symbols as s
from dynamics.derivation.lagrange import LagrangeEquations
from dynamics.derivation.linearised import linearised
from dynamics.derivation.symbols import Expr, sp
from dynamics.equations.parameters import Pendulum, RotorParameters


def rig_values(parameters: RotorParameters, sliding: tuple[int, int] = (1, 1)) -> dict[Expr, float]:
    """Values of the rig for the derivation's symbols, in the order of `symbols.RIG`.

    Args:
        parameters: the rig.
        sliding: sign of θ̇ of pendulums A and B for dry friction.
    """
    p = parameters
    c1, c2 = p.damping_Ns_per_m
    values = (
        p.rotor_mass_kg,
        p.imbalance_mass_kg,
        p.imbalance_radius_m,
        p.a.mass_kg,
        p.a.length_m,
        p.b.mass_kg,
        p.b.length_m,
        p.k1_N_per_m,
        p.k2_N_per_m,
        c1,
        c2,
        p.a.damping_Nms_per_rad,
        p.b.damping_Nms_per_rad,
        p.gravity_m_per_s2,
        p.pivot_shift_m,
        float(p.pivot_shift_compensated),
        p.a.friction_arm_m,
        p.b.friction_arm_m,
        *sliding,
        p.a.ball_radius_m,
        p.b.ball_radius_m,
        _kappa(p.a),
        _kappa(p.b),
    )
    return dict(zip(s.RIG, values, strict=True))


def _kappa(pendulum: Pendulum) -> float:
    return pendulum.ball_inertia_ratio if pendulum.ball_radius_m > 0 else 0.0


def moving_rows(parameters: RotorParameters, released: tuple[bool, bool]) -> list[int]:
    """Rows of the equations that a scene uses: the disk's two rows and those of the free pendulums.

    A lock keeps θ̇ = θ̈ = 0 with a torque that the pendulum's row would determine, so its row and column are removed.
    A pendulum without mass has no row.
    """
    present = parameters.a.present and released[0], parameters.b.present and released[1]
    return [0, 1, *(2 + i for i, moves in enumerate(present) if moves)]


@functools.cache
def compiled(build: Callable[[], LagrangeEquations]) -> Callable[..., Any]:
    """(mass matrix, right side, |right side|, ∂residual/∂coordinates, ∂residual/∂rates) as an mpmath function.

    |right side| is the sum of the absolute values of its terms: the scale of rounding errors.

    Args:
        build: `lagrange_equations` or `rotating_frame_equations`.
    Returns:
        Function of (coordinates, rates, accelerations, PHASE, RIG), all flat, with mpmath's working precision.
    """
    equations = build()

    def size(expression: Expr) -> Expr:
        return sp.Add(*(sp.Abs(term) for term in sp.Add.make_args(expression)))

    sizes = equations.right_side.applyfunc(size)
    linear = linearised(equations.residual, equations)
    arguments = (*equations.coordinates, *equations.rates, *equations.accelerations, *s.PHASE, *s.RIG)
    results = [equations.mass_matrix, equations.right_side, sizes, linear.stiffness, linear.damping]
    return sp.lambdify(arguments, results, "mpmath", cse=True)


def scene_arguments(
    state: Sequence[float], phase: Sequence[float], parameters: RotorParameters, released: tuple[bool, bool]
) -> tuple[list[float], list[float]]:
    """Coordinates with rates (8), and phase with the rig's values, as arguments of `compiled`.

    Args:
        state: shape (8,): x, y, θ3, θ4 and their rates (SI). The rate of a locked pendulum is replaced by 0.
        phase: ψ, ω, α.
    """
    rates = [*state[4:6], *(v if free else 0.0 for v, free in zip(state[6:8], released, strict=True))]
    sliding = tuple(1 if v >= 0 else -1 for v in rates[2:])
    values = rig_values(parameters, (sliding[0], sliding[1]))
    return [*state[:4], *rates], [*phase, *values.values()]
