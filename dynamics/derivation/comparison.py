"""Comparison of every printed equation with the derivation, cell by cell."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from dynamics.derivation import source_equations as source, symbols as s
from dynamics.derivation.lagrange import energies, lagrange_equations, rotating_frame_equations
from dynamics.derivation.linearised import ISOTROPIC, singular_point_equations, singular_point_matrices
from dynamics.derivation.symbols import Expr, Matrix, sp


@dataclass(frozen=True)
class Deviation:
    """One cell that differs from the derivation.

    Attributes:
        row, column: position in the matrix, counted from 1; (1, 1) for a scalar equation.
        printed, right: the source's expression and the derived one, in normal form.
    """

    row: int
    column: int
    printed: Expr
    right: Expr

    @property
    def surplus(self) -> Expr:
        """printed − right."""
        return s.normal_form(self.printed - self.right)


@dataclass(frozen=True)
class EquationComparison:
    """One printed equation or matrix with its deviations.

    Attributes:
        number: number in the source, for example "4-7".
        subject: description of the equation.
        deviations: cells that differ; empty if the equation is correct.
    """

    number: str
    subject: str
    deviations: tuple[Deviation, ...]

    @property
    def agrees(self) -> bool:
        """Whether no cell differs."""
        return not self.deviations


def compare(number: str, subject: str, printed: Expr | Matrix, right: Expr | Matrix) -> EquationComparison:
    """Compare two expressions, or two matrices of equal shape, in normal form."""
    left_cells, right_cells = (m.tolist() if isinstance(m, sp.MatrixBase) else [[m]] for m in (printed, right))
    found: list[Deviation] = []
    for i, (left_row, right_row) in enumerate(zip(left_cells, right_cells, strict=True)):
        for j, (left, ours) in enumerate(zip(left_row, right_row, strict=True)):
            theirs, belongs = s.in_moments(left), s.in_moments(ours)
            if s.normal_form(belongs - theirs) != 0:
                found.append(Deviation(i + 1, j + 1, theirs, belongs))
    return EquationComparison(number, subject, tuple(found))


def _rotor_alone_comparisons() -> list[EquationComparison]:
    """Equations of chapter 2, the rotor without pendulums, with (3-33) and (3-34)."""
    alone = {s.M_A: 0, s.M_B: 0} | s.PLAIN | ISOTROPIC
    right = lagrange_equations().residual.subs(alone).flat()
    mass, c, k, omega = s.M_D + s.M_P, s.c1, s.k1, s.omega
    moment = s.M_P * s.P_3
    amplitude = omega**2 * moment / mass / sp.sqrt((k / mass - omega**2) ** 2 + (c * omega / mass) ** 2)
    printed_n = mass * omega**2 / sp.sqrt(omega**2 * c**2 + k**2 - 2 * k * omega**2 * mass + omega**4 * mass**2)
    response = (k - mass * omega**2) ** 2 + (omega * c) ** 2  # |k − M ω² + i ω c|²
    lag = sp.atan(omega * c / (mass * (k / mass - omega**2))), sp.atan2(omega * c, k - mass * omega**2)
    eccentricity = moment / mass, s.S_P / s.M_S

    def equal(number: str, subject: str, printed: Expr, ours: Expr) -> EquationComparison:
        found = () if sp.simplify(printed - ours) == 0 else (Deviation(1, 1, printed, ours),)
        return EquationComparison(number, subject, found)

    natural = sp.sqrt(k / (s.M_D + s.M_A + s.M_B + s.M_P))
    inertia = lagrange_equations().mass_matrix.tolist()[0][0]
    return [
        compare(
            "2-1",
            "motion along x, rotor alone",
            s.ddx * mass + s.dx * c + s.x * k - moment * omega**2 * sp.cos(s.psi),
            right[0],
        ),
        compare(
            "2-2",
            "motion along y, rotor alone",
            s.ddy * mass + s.dy * c + s.y * k - moment * omega**2 * sp.sin(s.psi),
            right[1],
        ),
        equal("2-6", "amplitude along x", amplitude**2, omega**4 * moment**2 / response),
        equal("2-7", "amplitude along y", amplitude**2, omega**4 * moment**2 / response),
        EquationComparison("2-9", "phase lag", () if _same_above_resonance(*lag) else (Deviation(1, 1, *lag),)),
        equal("2-10", "magnification", printed_n**2, mass**2 * omega**4 / response),
        equal("3-33", "natural frequency", natural**2 * inertia, k),
        EquationComparison(
            "3-34",
            "eccentricity",
            () if compare("3-34", "", *eccentricity).agrees else (Deviation(1, 1, *eccentricity),),
        ),
    ]


def _same_above_resonance(printed: Expr, right: Expr) -> bool:
    """Whether two expressions of the phase lag are equal at a speed above resonance."""
    at = {s.M_D: 7, s.M_P: 0.12, s.k1: 2500, s.c1: 10, s.omega: 60}
    return abs(float(printed.subs(at)) - float(right.subs(at))) < 1e-9


def _energy_comparisons() -> list[EquationComparison]:
    ours = energies(turning=True)
    plain = {e: (x.subs(s.PLAIN)) for e, x in vars(ours).items() if e != "forces"}
    kinetic = plain["kinetic"] + s.omega**2 * source.SPIN / 2
    return [
        compare("3-9", "kinetic energy", source.KINETIC, kinetic),
        compare("3-10", "potential energy", source.POTENTIAL_ISOTROPIC, plain["potential"].subs(ISOTROPIC)),
        compare("3-11", "dissipation function", source.DISSIPATION_ISOTROPIC, plain["dissipation"].subs(ISOTROPIC)),
        compare("4-2", "kinetic energy", source.KINETIC, kinetic),
        compare("4-3", "potential energy", source.POTENTIAL, plain["potential"]),
        compare("4-4", "dissipation function", source.DISSIPATION, plain["dissipation"]),
    ]


def _motion_comparisons() -> list[EquationComparison]:
    moving = rotating_frame_equations().residual.subs(s.PLAIN)
    right, isotropic = moving.flat(), moving.subs(ISOTROPIC).flat()
    rows = ("motion along Θ1", "motion along Θ2", "motion of pendulum A", "motion of pendulum B")
    third = (source.EQUATION_3_13, source.EQUATION_3_14, source.PENDULUM_A, source.PENDULUM_B)
    fourth = (source.EQUATION_4_6, source.EQUATION_4_7, source.PENDULUM_A, source.PENDULUM_B)
    return [
        *(compare(f"3-{13 + i}", rows[i], third[i], isotropic[i]) for i in range(4)),
        *(compare(f"4-{6 + i}", rows[i], fourth[i], right[i]) for i in range(4)),
    ]


def _singular_point_comparisons() -> list[EquationComparison]:
    resting = singular_point_equations()
    right, isotropic = resting.flat(), resting.subs(ISOTROPIC).flat()
    rows = ("force balance along Θ1", "force balance along Θ2", "torque on A", "torque on B")
    third = (source.EQUATION_3_17, source.EQUATION_3_18, source.TORQUE_A, source.TORQUE_B)
    fourth = (source.EQUATION_4_10, source.EQUATION_4_11, source.TORQUE_A, source.TORQUE_B)
    return [
        *(compare(f"3-{17 + i}", rows[i], third[i], isotropic[i]) for i in range(4)),
        *_angle_comparisons(),
        *(compare(f"4-{10 + i}", rows[i], fourth[i], right[i]) for i in range(4)),
    ]


def _angle_comparisons() -> list[EquationComparison]:
    """(3-21), (3-22): comparison of the printed arguments with sine and cosine of the triangle of moments."""
    S_A, S_B, S_P = s.S_A, s.S_B, s.S_P
    area = sp.sqrt(((S_A + S_B) ** 2 - S_P**2) * (S_P**2 - (S_A - S_B) ** 2))
    sines = (-area / (2 * S_P * S_A), area / (2 * S_P * S_B))
    cosines = ((S_B**2 - S_A**2 - S_P**2) / (2 * S_P * S_A), (S_A**2 - S_B**2 - S_P**2) / (2 * S_P * S_B))
    found: list[EquationComparison] = []
    for n, printed in enumerate(source.balanced_angle_arguments()):
        deviations = tuple(
            Deviation(1, i + 1, theirs, ours)
            for i, (theirs, ours) in enumerate(zip(printed, (sines[n], cosines[n]), strict=True))
            if sp.simplify(theirs / ours) != 1
        )
        found.append(EquationComparison(f"3-{21 + n}", f"Type I angle of pendulum {'AB'[n]}", deviations))
    return found


def _matrix_comparisons() -> list[EquationComparison]:
    right = singular_point_matrices()
    isotropic = right.subs(ISOTROPIC)
    third = (source.INERTIA, source.DAMPING_ISOTROPIC, source.STIFFNESS_ISOTROPIC)
    fourth = (source.INERTIA, source.DAMPING, source.STIFFNESS)
    names = ("[M]", "[D + G]", "[K + N]")
    found: list[EquationComparison] = []
    for chapter, first, printed, ours in ((3, 27, third, isotropic), (4, 15, fourth, right)):
        cells = (ours.inertia, ours.damping, ours.stiffness)
        found += [compare(f"{chapter}-{first + i}", names[i], printed[i], cells[i]) for i in range(3)]
    return found


@functools.cache
def comparisons() -> tuple[EquationComparison, ...]:
    """Comparisons of all printed equations with the derivation, in the source's order."""
    found = [
        *_rotor_alone_comparisons(),
        *_energy_comparisons(),
        *_motion_comparisons(),
        *_singular_point_comparisons(),
        *_matrix_comparisons(),
    ]
    return tuple(sorted(found, key=lambda c: [int(n) for n in c.number.split("-")]))


def comparison(number: str) -> EquationComparison:
    """Comparison of one printed equation.

    Raises:
        KeyError: no compared equation has this number.
    """
    return {c.number: c for c in comparisons()}[number]
