"""The source's numbered definitions and methods, each verified by a property.

`dynamics.derivation.comparison` compares equations cell by cell. The remaining numbered items are names, regions, forms
and numerical methods. Each is verified by a property that an incorrect definition would not have.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.integrate
import scipy.linalg

from dynamics.arrays import Array
from dynamics.derivation import source_equations as source, symbols as s
from dynamics.derivation.comparison import compare
from dynamics.derivation.effects import POINTS, NumericMotion, rig, variants
from dynamics.derivation.lagrange import lagrange_equations, rotating_frame_equations
from dynamics.derivation.linearised import ISOTROPIC
from dynamics.derivation.symbols import Expr, sp
from dynamics.equations.balancing import balanced_angles, closing_angles
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.steady.singular_points import singular_points
from rig_basics.texts import number_of

_integrators: Any = scipy.integrate  # scipy has no annotations
_linear_algebra: Any = scipy.linalg
_SEED = 36
_SINGULAR, _SLOPE, _RIGHT = 1e-10, 1e-5, 1e-8
_FORM = "the derived matrices in this form obey it"


@dataclass(frozen=True)
class Checked:
    """A verified definition or method of the source.

    Attributes:
        number: number in the source, for example "3-4".
        subject: description of the item.
        agrees: whether the property holds.
        how: the property, with its numerical results.
    """

    number: str
    subject: str
    agrees: bool
    how: str


def _alone() -> tuple[Expr, Expr, Expr]:
    """Squared amplitude of the rotor alone, N² from (2-10), and e from (2-8)."""
    mass, moment = s.M_D + s.M_P, s.M_P * s.P_3
    response = (s.k1 - mass * s.omega**2) ** 2 + (s.omega * s.c1) ** 2
    return s.omega**4 * moment**2 / response, mass**2 * s.omega**4 / response, moment / mass


def _chapter_two() -> list[Checked]:
    amplitude, magnification, eccentricity = _alone()
    mass = s.M_D + s.M_P
    inertia = lagrange_equations().mass_matrix[0, 0].subs({s.M_A: 0, s.M_B: 0} | s.PLAIN)
    two = [lagrange_equations().residual[i].subs({s.M_A: 0, s.M_B: 0} | s.PLAIN) for i in (0, 1)]
    isotropic = [
        sp.simplify(row.coeff(rate) - other) == 0
        for row, rate, other in zip(
            [row.subs(ISOTROPIC).expand() for row in two for _ in (0, 1)],
            (s.dx, s.x, s.dy, s.y),
            (s.c1, s.k1, s.c1, s.k1),
            strict=True,
        )
    ]
    far = sp.limit(
        sp.sqrt(amplitude.subs({s.M_D: 7, s.M_P: sp.Rational(3, 25), s.P_3: 1, s.k1: 2500, s.c1: 10})), s.omega, sp.oo
    )
    slow = sp.limit(amplitude, s.omega, 0)
    reached = sp.Rational(3, 25) / sp.Rational(178, 25)
    return [
        Checked("2-3", "total mass", sp.simplify(inertia - mass) == 0, "the derived inertia without pendulums"),
        Checked("2-4", "one damping", all(isotropic), "with it and (2-5) the derived equations have one coefficient"),
        Checked("2-5", "one stiffness", all(isotropic), "as (2-4)"),
        Checked(
            "2-8",
            "eccentricity, rotor alone",
            sp.simplify(far - reached) == 0,
            "the limit of the amplitude (2-6) far above resonance",
        ),
        Checked(
            "2-11",
            "N as a ratio",
            sp.simplify(amplitude / eccentricity**2 - magnification) == 0,
            "(2-6) over (2-13) is (2-10)",
        ),
        Checked(
            "2-12",
            "amplitude",
            sp.simplify(sp.cos(s.psi) ** 2 + sp.sin(s.psi) ** 2) == 1,
            "(2-6), (2-7) squared and added hold no time",
        ),
        Checked(
            "2-13",
            "A_Stat",
            slow == 0 and sp.simplify(eccentricity - s.M_P * s.P_3 / mass) == 0,
            "it is e of (2-8); the name misleads: reached far above resonance, while the static amplitude is 0",
        ),
    ]


def _moments() -> list[Checked]:
    rng = np.random.default_rng(_SEED)
    sides = rng.uniform(0.0, 1.0, (2000, 3))
    exists = np.array([bool(closing_angles(a, b, complex(-p, 0))) for a, b, p in sides.tolist()])
    a, b, p = sides.T
    proper = (a + b >= p) & (np.abs(a - b) <= p)
    improper, under = np.abs(a - b) > p, a + b < p
    one = np.all(proper.astype(int) + improper + under == 1)
    pendulum = Pendulum(0.075, 0.054, 1e-3).first_moment_kg_m == 0.075 * 0.054
    imbalance = math.isclose(rig().imbalance_moment_kg_m, rig().imbalance_mass_kg * rig().imbalance_radius_m)
    overlap = int(np.count_nonzero(improper & (np.abs(a - b) < p)))
    return [
        Checked("3-1", "S_A", pendulum, "the project's first mass moment"),
        Checked("3-2", "S_B", pendulum, "as (3-1)"),
        Checked("3-3", "S_P", imbalance, "the project's moment of the imbalance"),
        Checked(
            "3-4",
            "properly oversized",
            bool(np.all(proper == exists)),
            f"balanced angles exist for exactly these of {number_of(len(sides), 'random set')} of moments",
        ),
        Checked(
            "3-5",
            "improperly oversized",
            bool(one and not np.any(exists & improper)),
            "with (3-4), (3-6) every set is in one region, and none of this one can be balanced",
        ),
        Checked("3-6", "undersized", bool(one and not np.any(exists & under)), "as (3-5)"),
        Checked(
            "3-7",
            "improperly oversized, yet of use",
            overlap > 0,
            f"{overlap} of {number_of(int(improper.sum()), 'such set')} fulfil it: it contradicts (3-5); last section",
        ),
    ]


def lagrange_rows(kinetic: Expr, potential: Expr, dissipation: Expr) -> list[Expr]:
    """(3-8) applied to given energies in the rotating frame, Q_i = 0: four expressions that are zero along a motion."""
    coordinates = (s.Y1, s.Y2, s.theta3, s.theta4)
    rates = (s.dY1, s.dY2, s.dtheta3, s.dtheta4)
    accelerations = (s.ddY1, s.ddY2, s.ddtheta3, s.ddtheta4)
    rows: list[Expr] = []
    for q, dq in zip(coordinates, rates, strict=True):
        momentum = sp.diff(kinetic, dq)
        change = (
            sum(
                sp.diff(momentum, each) * rate
                for each, rate in zip((*coordinates, *rates), (*rates, *accelerations), strict=True)
            )
            + sp.diff(momentum, s.psi) * s.omega
        )
        rows.append(change - sp.diff(kinetic, q) + sp.diff(potential, q) + sp.diff(dissipation, dq))
    return rows


def _lagrange() -> list[Checked]:
    right = rotating_frame_equations().residual.subs(s.PLAIN)
    third = lagrange_rows(source.KINETIC, source.POTENTIAL_ISOTROPIC, source.DISSIPATION_ISOTROPIC)
    fourth = lagrange_rows(source.KINETIC, source.POTENTIAL, source.DISSIPATION)
    isotropic = all(
        compare("3-8", "", row, ours).agrees for row, ours in zip(third, right.subs(ISOTROPIC), strict=True)
    )
    whole = all(compare("4-1", "", row, ours).agrees for row, ours in zip(fourth, right, strict=True))
    return [
        Checked(
            "3-8",
            "Lagrange's equations",
            isotropic,
            "with the printed energies (3-9) to (3-11) they give the derived motion",
        ),
        Checked("3-12", "no generalised forces", isotropic, "as (3-8): the imbalance is in the kinetic energy"),
        Checked(
            "4-1",
            "Lagrange's equations",
            whole,
            "with the printed energies (4-2) to (4-4) they give the derived motion",
        ),
        Checked("4-5", "no generalised forces", whole, "as (4-1)"),
    ]


def _types() -> list[Checked]:
    p = rig(stiffness_ratio=1.0, zeta=0.05)
    found = [point for ratio in (0.8, 2.5) for point in singular_points(p, p.speed_rad_s(ratio))]

    def gaps(kind: str) -> list[tuple[float, float]]:
        """Difference of the angles (rad) and |z| (m) of the points of one type."""
        return [
            ((point.theta_rad[1] - point.theta_rad[0]) % (2 * math.pi), abs(point.z_m))
            for point in found
            if point.type == kind
        ]

    one, two, three = gaps("I"), gaps("II"), gaps("III")
    return [
        Checked("3-23", "Type I", bool(one) and all(z == 0 for _, z in one), "the derived ones are at rest"),
        Checked(
            "3-24",
            "Type II",
            bool(two) and all(abs(gap - math.pi) < 1e-12 and z > 0 for gap, z in two),
            "the derived ones whirl, 180° apart",
        ),
        Checked(
            "3-25",
            "Type III",
            bool(three) and all(abs(math.sin(gap / 2)) < 1e-12 and z > 0 for gap, z in three),
            "the derived ones whirl, together",
        ),
    ]


def _first_order() -> list[Checked]:
    """(3-26), (3-30) to (3-32), (4-14), (4-18) to (4-20): eigenvalues of [A] are roots of the quadratic pencil."""
    motion, p = variants()["derived"], rig()
    omega, angles = p.speed_rad_s(POINTS["B"]), balanced_angles(p)[0]
    a = motion.system(p, 0.3, omega, (0.0, 0.0, *angles))
    upper = bool(np.array_equal(a[:4], np.hstack([np.zeros((4, 4)), np.eye(4)])))
    inertia, damping, stiffness = _matrices(motion, p, 0.3, omega, angles)
    values = np.linalg.eigvals(a)
    pencils = [inertia * value**2 + damping * value + stiffness for value in values]
    singular = max(float(np.linalg.svd(m, compute_uv=False)[-1] / np.linalg.norm(m)) for m in pencils)
    agrees = upper and singular < _SINGULAR
    how = f"its eigenvalues make [M] λ² + [D + G] λ + [K + N] singular within {_SINGULAR:.0e}"
    subjects = {
        "3-26": "motion about a singular point",
        "3-30": "state",
        "3-31": "first order",
        "3-32": "[A]",
        "4-14": "motion about a singular point",
        "4-18": "first order",
        "4-19": "state",
        "4-20": "[A(t)]",
    }
    forms = {number: _FORM if number in ("3-26", "4-14") else how for number in subjects}
    return [Checked(number, subject, agrees, forms[number]) for number, subject in subjects.items()]


def _matrices(
    motion: NumericMotion, p: RotorParameters, psi: float, omega: float, angles: tuple[float, float]
) -> list[Array]:
    moments = p.total_mass_kg, p.a.first_moment_kg_m, p.b.first_moment_kg_m, p.imbalance_moment_kg_m
    return motion.matrices(p, psi, omega, (0.0, 0.0, *angles), moments)


def _floquet() -> list[Checked]:
    motion, p = variants()["derived"], rig()
    omega, angles = p.speed_rad_s(POINTS["B"]), balanced_angles(p)[0]

    def a(t: float) -> Array:
        return motion.system(p, omega * t, omega, (0.0, 0.0, *angles))

    period, h = 2 * math.pi / omega, 1e-6
    ends = [0.4 * period, 0.4 * period + h, 0.4 * period + 2 * h]

    def phi(until: float) -> Array:
        def rate(t: float, y: Array) -> Array:
            return (a(t) @ y.reshape(8, 8)).ravel()

        run = _integrators.solve_ivp(
            rate,
            (0.0, until),
            np.eye(8).ravel(),
            "DOP853",
            rtol=1e-12,
            atol=1e-12,
        )
        return run.y[:, -1].reshape(8, 8)

    first, middle, last = (phi(t) for t in ends)
    slope = float(np.max(np.abs((last - first) / (2 * h) - a(ends[1]) @ middle)) / np.max(np.abs(a(ends[1]) @ middle)))
    product, swapped = _piece_errors((a(0.0), a(0.3 * period)), 0.1 * period)
    truth = float(motion.multipliers(p, [POINTS["B"]], 2000)[0])
    errors = [abs(motion.piecewise_multiplier(p, POINTS["B"], n, 0.5) - truth) for n in (100, 200)]
    order = math.log2(errors[0] / errors[1])
    in_order = product < _RIGHT and swapped > 1.0
    return [
        Checked(
            "4-21",
            "fundamental matrix",
            slope < _SLOPE,
            f"a computed one obeys it within {_SLOPE:.0e}; next to it two arguments are lost: last section",
        ),
        Checked(
            "4-22",
            "solution over pieces",
            in_order,
            f"the latest piece stands left: off an integration by less than {_RIGHT:.0e}, the other way round by "
            "more than 1",
        ),
        Checked("4-23", "pieces", in_order, "as (4-22)"),
        Checked("4-24", "principal matrix over pieces", in_order, "as (4-22)"),
        Checked(
            "4-25",
            "values in the middle of the pieces",
            1.9 < order < 2.1,
            f"the multiplier at B converges with order {order:.1f}",
        ),
    ]


def _piece_errors(matrices: tuple[Array, Array], duration_s: float) -> tuple[float, float]:
    """Errors of the product of two pieces' exponentials against an integration: the latest piece left, then right."""
    pieces = [_linear_algebra.expm(duration_s * m) for m in matrices]
    run = np.eye(8)[:, 4]
    for matrix in matrices:

        def constant(t: float, y: Array, m: Array = matrix) -> Array:
            del t
            return m @ y

        run = _integrators.solve_ivp(constant, (0.0, duration_s), run, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    product = float(np.max(np.abs(pieces[1] @ pieces[0] @ np.eye(8)[:, 4] - run)))
    swapped = float(np.max(np.abs(pieces[0] @ pieces[1] @ np.eye(8)[:, 4] - run)))
    return product, swapped


def _misalignment() -> list[Checked]:
    p = rig(stiffness_ratio=1.0, zeta=0.001)
    speed = p.speed_rad_s(20.0)
    balanced = [point for point in singular_points(p, speed) if point.type == "I"]
    locked = abs(
        speed**2
        * p.imbalance_moment_kg_m
        / complex(p.k1_N_per_m - p.total_mass_kg * speed**2, speed * p.damping_Ns_per_m[0])
    )
    alpha = abs(balanced[0].z_m) / locked
    return [
        Checked("3-35", "α", alpha == 0.0 and locked > 0, "0 for balanced pendulums without a shift, 1 for locked ones")
    ]


@functools.cache
def definitions() -> tuple[Checked, ...]:
    """All numbered definitions and methods of chapters 2 to 4, in the source's order."""
    makers: tuple[Callable[[], list[Checked]], ...] = (
        _chapter_two,
        _moments,
        _lagrange,
        _types,
        _first_order,
        _misalignment,
        _floquet,
    )
    found = [checked for make in makers for checked in make()]
    return tuple(sorted(found, key=lambda c: [int(n) for n in c.number.split("-")]))
