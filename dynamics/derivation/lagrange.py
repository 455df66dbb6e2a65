"""Equations of motion of every scene, from energies.

One derivation covers all scenes. A scene is a substitution (`dynamics.derivation.scenes`). Positions are written in a
frame that is at rest or rotates with the rotor. Only the space-fixed springs, dampers and gravity depend on the frame's
angle.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

from dynamics.derivation import symbols as s
from dynamics.derivation.symbols import Expr, Matrix, Symbol, sp


@dataclass(frozen=True)
class LagrangeEquations:
    """Lagrange's equations: mass_matrix · accelerations = right_side.

    Attributes:
        mass_matrix: shape (4, 4), symmetric; rows x, y (N) and θ3, θ4 (N m).
        right_side: shape (4, 1), free of accelerations.
        coordinates, rates, accelerations: four symbols each; the first two in m, the others in rad.
    """

    mass_matrix: Matrix
    right_side: Matrix
    coordinates: tuple[Symbol, ...]
    rates: tuple[Symbol, ...]
    accelerations: tuple[Symbol, ...]

    @property
    def residual(self) -> Matrix:
        """mass_matrix · accelerations − right_side, shape (4, 1): zero along a motion."""
        return self.mass_matrix * sp.Matrix(self.accelerations) - self.right_side


@dataclass(frozen=True)
class Energies:
    """Energies and forces of Lagrange's equations.

    Attributes:
        kinetic, potential: energies, J.
        dissipation: Rayleigh's function, W (half the power dissipated in the dampers).
        forces: the four generalised forces of dry friction, N and N m.
    """

    kinetic: Expr
    potential: Expr
    dissipation: Expr
    forces: tuple[Expr, ...]


def _coordinates(turning: bool) -> tuple[tuple[Symbol, ...], ...]:
    if turning:
        return (
            (s.Y1, s.Y2, s.theta3, s.theta4),
            (s.dY1, s.dY2, s.dtheta3, s.dtheta4),
            (s.ddY1, s.ddY2, s.ddtheta3, s.ddtheta4),
        )
    return (
        (s.x, s.y, s.theta3, s.theta4),
        (s.dx, s.dy, s.dtheta3, s.dtheta4),
        (s.ddx, s.ddy, s.ddtheta3, s.ddtheta4),
    )


def energies(turning: bool = False) -> Energies:
    """Energies, dissipation and friction of the whole rig.

    Args:
        turning: whether the disk centre is given in the rotating frame (Y1, Y2) instead of the space-fixed one (x, y).
    """
    coordinates, rates, _ = _coordinates(turning)
    frame, frame_rate = (s.psi, s.omega) if turning else (sp.Integer(0), sp.Integer(0))
    quarter_turn = sp.Matrix([[0, -1], [1, 0]])
    turn = sp.Matrix([[sp.cos(frame), -sp.sin(frame)], [sp.sin(frame), sp.cos(frame)]])

    def velocity(position: Matrix) -> Matrix:
        return total_derivative(position, coordinates, rates) + frame_rate * quarter_turn * position

    def direction(angle: Expr) -> Matrix:
        return sp.Matrix([sp.cos(angle - frame), sp.sin(angle - frame)])

    centre = sp.Matrix(coordinates[:2])
    pivot = centre + s.R_C * direction(s.psi)
    v_centre, v_imbalance = velocity(centre), velocity(centre + s.P_3 * direction(s.psi))
    kinetic = s.M_D * v_centre.dot(v_centre) / 2 + s.M_P * v_imbalance.dot(v_imbalance) / 2
    # The brass weights that compensate the shift have the first moment −(M_A + M_B) R_C and no mass
    kinetic -= s.compensated * (s.M_A + s.M_B) * s.R_C * v_centre.dot(velocity(direction(s.psi)))
    potential = s.g * (s.M_D + s.M_P) * (turn * centre)[1]
    forces: list[Expr] = [sp.Integer(0), sp.Integer(0)]
    arms = (
        (s.theta3, s.dtheta3, s.M_A, s.R_A, s.r_A, s.kappa_A, s.h_A, s.sign_A),
        (s.theta4, s.dtheta4, s.M_B, s.R_B, s.r_B, s.kappa_B, s.h_B, s.sign_B),
    )
    for theta, rate, mass, length, radius, kappa, arm, sign in arms:
        place = pivot + length * direction(s.psi + theta)
        v = velocity(place)
        # ½ κ m r² (ω − θ̇ R/r)²: ball that rolls on the channel's outer wall; κ = 0 for a pendulum
        kinetic += mass * v.dot(v) / 2 + kappa * mass * (radius * s.omega - length * rate) ** 2 / 2
        potential += s.g * mass * (turn * place)[1]
        forces.append(-sign * arm * mass * length * (s.omega + rate) ** 2)
    seen, v_seen = turn * centre, turn * v_centre
    potential += (s.k1 * seen[0] ** 2 + s.k2 * seen[1] ** 2) / 2
    lost = s.c1 * v_seen[0] ** 2 + s.c2 * v_seen[1] ** 2 + s.c3 * rates[2] ** 2 + s.c4 * rates[3] ** 2
    return Energies(kinetic, potential, lost / 2, tuple(forces))


def total_derivative(expression: Matrix, coordinates: Sequence[Symbol], rates: Sequence[Symbol]) -> Matrix:
    """d/dt of a matrix that contains coordinates, ψ and ω but no rates."""
    change = expression.diff(s.psi) * s.omega + expression.diff(s.omega) * s.alpha
    for coordinate, rate in zip(coordinates, rates, strict=True):
        change += expression.diff(coordinate) * rate
    return change


def equations_of_motion(turning: bool, e: Energies) -> LagrangeEquations:
    """d/dt ∂T/∂q̇ − ∂T/∂q + ∂V/∂q + ∂D/∂q̇ = Q, sorted by accelerations.

    Args:
        turning: whether the energies are written in the coordinates of the rotating frame.
        e: energies, dissipation and forces in these coordinates.
    """
    coordinates, rates, accelerations = _coordinates(turning)
    momenta = sp.Matrix([e.kinetic.diff(v) for v in rates])
    mass_matrix = momenta.jacobian(list(rates)).applyfunc(s.normal_form)
    # the momenta are linear in the rates, so d/dt without its acceleration terms is their total derivative
    carried = total_derivative(momenta, coordinates, rates)
    applied = sp.Matrix(
        [
            e.kinetic.diff(q) - e.potential.diff(q) - e.dissipation.diff(v) + force
            for q, v, force in zip(coordinates, rates, e.forces, strict=True)
        ]
    )
    right_side = (applied - carried).applyfunc(s.normal_form)
    return LagrangeEquations(mass_matrix, right_side, coordinates, rates, accelerations)


@functools.cache
def lagrange_equations() -> LagrangeEquations:
    """Equations in the space-fixed frame, coordinates x, y, θ3, θ4. Symbols: dynamics.derivation.symbols."""
    return equations_of_motion(False, energies(False))


@functools.cache
def rotating_frame_equations() -> LagrangeEquations:
    """Equations in the rotating frame, x + i y = (Y1 + i Y2) e^{iψ}, coordinates Y1, Y2, θ3, θ4."""
    return equations_of_motion(True, energies(True))
