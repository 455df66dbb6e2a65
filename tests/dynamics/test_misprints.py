"""The source's printed equations held against the derivation, and the list of misprints against its generator."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from dynamics.derivation import (
    misprint_numbers,
    misprints,
    rotating_frame_equations,
    source_equations as source,
    source_listing,
    symbols as s,
)
from dynamics.derivation.comparison import compare, comparison, comparisons
from dynamics.derivation.definitions import definitions, lagrange_rows
from dynamics.derivation.effects import POINTS, rig, variants
from dynamics.derivation.misprint_pieces import PIECES, unexplained
from dynamics.derivation.run_up_faults import PrintedFaults, release, script_rates
from dynamics.derivation.scenes import rig_values
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.kernels import rates

LIST = Path(__file__).parents[2] / "docs" / "book" / "misprints.md"
# Equations with their wrong cells; every other one printed agrees
WRONG = {
    "2-9": {(1, 1)},
    "3-17": {(1, 1)},
    "3-22": {(1, 1), (1, 2)},
    "3-27": {(4, 1)},
    "3-28": {(3, 2), (4, 2)},
    "3-29": {(3, 2), (3, 3), (4, 4)},
    "3-34": {(1, 1)},
    "4-6": {(1, 1)},
    "4-7": {(1, 1)},
    "4-10": {(1, 1)},
    "4-11": {(1, 1)},
    "4-15": {(4, 1)},
    "4-16": {(1, 1), (2, 2), (3, 2), (4, 2)},
    "4-17": {(1, 1), (2, 2), (3, 2), (3, 3), (4, 4)},
}


def test_the_list_is_what_its_generator_writes() -> None:
    """After a change: python -m dynamics.derivation.misprints > docs/book/misprints.md"""
    assert misprints.text() == LIST.read_text(encoding="utf-8")


def test_which_cells_differ() -> None:
    found = {c.number: {(d.row, d.column) for d in c.deviations} for c in comparisons() if not c.agrees}
    assert found == WRONG
    assert len(comparisons()) == 38


def test_every_numbered_equation_of_three_chapters_has_a_row() -> None:
    wanted = {f"{chapter}-{i}" for chapter, last in ((2, 13), (3, 35), (4, 25)) for i in range(1, last + 1)}
    compared, defined = [c.number for c in comparisons()], [d.number for d in definitions()]
    assert sorted(compared + defined) == sorted(wanted)
    assert [d.number for d in definitions() if not d.agrees] == ["3-7"]
    rows = {line.split(" | ")[0][2:] for line in misprints.verdicts()[2:]}
    assert rows == wanted


def test_energies_with_a_wrong_term_do_not_give_the_motion() -> None:
    right = rotating_frame_equations().residual.subs(s.PLAIN)
    wrong = lagrange_rows(source.KINETIC + s.S_A * s.Y1 * s.dtheta3, source.POTENTIAL, source.DISSIPATION)
    assert [compare("", "", row, ours).agrees for row, ours in zip(wrong, right, strict=True)] == [
        False,
        True,
        False,
        True,
    ]


def test_the_key_deviations() -> None:
    """By hand: what is printed less what belongs there."""
    S_A, S_B, w = s.S_A, s.S_B, s.omega

    def surplus(number: str, row: int, column: int) -> sp.Expr:
        return next(d.surplus for d in comparison(number).deviations if (d.row, d.column) == (row, column))

    sin3, cos3, sin4, cos4 = sp.sin(s.theta3), sp.cos(s.theta3), sp.sin(s.theta4), sp.cos(s.theta4)
    pull = s.Y1 * cos3 + s.Y2 * sin3
    double = (s.c1 - s.c2) * sp.cos(2 * s.psi)
    sigma = (s.c2 - s.c1) * sp.sin(s.psi) * sp.cos(s.psi)
    expected = {
        ("3-27", 4, 1): S_B * (sin4 - sin3),
        ("3-28", 3, 2): -4 * w * S_A * sin3,
        ("3-28", 4, 2): -4 * w * S_B * sin4,
        ("3-29", 3, 2): w**2 * S_A * (cos3 - cos4),
        ("3-29", 3, 3): S_A * pull * (1 - w**2),
        ("3-17", 1, 1): w**2 * s.S_P,
        ("4-10", 1, 1): w**2 * s.S_P,
        ("4-16", 1, 1): -double,
        ("4-16", 2, 2): double,
        ("4-17", 1, 1): (1 - w) * sigma,
        ("4-17", 2, 2): (w - 1) * sigma,
    }
    for place, value in expected.items():
        assert s.normal_form(surplus(*place) - value) == 0, place


@pytest.mark.parametrize("number", PIECES)
def test_the_pieces_of_an_equation_make_its_deviation(number: str) -> None:
    assert unexplained(number) == 0


def test_printed_angles_are_the_balanced_ones() -> None:
    """(3-21), (3-22) point the right way although the arguments of the latter are twice too large."""
    p = rig(mass_b_kg=0.055)
    values = {
        s.S_A: p.a.first_moment_kg_m,
        s.S_B: p.b.first_moment_kg_m,
        s.S_P: p.imbalance_moment_kg_m,
    }
    found = [math.atan2(*(float(a.subs(values)) for a in pair)) for pair in source.balanced_angle_arguments()]
    distances = [np.max(np.abs(np.exp(1j * np.array(found)) - np.exp(1j * np.array(a)))) for a in balanced_angles(p)]
    assert min(distances) < 1e-12


def test_the_listings_equations_are_right_and_its_order_is_not() -> None:
    plain = {symbol: value for symbol, value in s.PLAIN.items() if symbol is not s.alpha}
    right = rotating_frame_equations().residual.subs(plain)
    difference = (right - source_listing.residuals()).applyfunc(s.in_moments)
    assert difference == sp.zeros(4, 1)
    evaluated = source_listing.residuals().subs(source_listing.NOT_YET_COMPUTED)
    assert (right - evaluated).applyfunc(s.in_moments)[0] != 0


def test_pendulum_a_as_listed_has_no_inertia() -> None:
    energy = source_listing.kinetic_energy_of_pendulum_a_as_listed()
    assert energy.diff(s.dtheta3) == 0
    assert sp.simplify(energy.diff(s.dtheta4, 2)) != 0


def test_multipliers_of_the_derived_matrices() -> None:
    """Six digits of an independent model in double precision: what the printed cells are measured against."""
    found = variants()["derived"].multipliers(rig(), POINTS.values())
    assert np.allclose(found, [1.361992, 0.937055, 0.974796, 1.373347, 0.978556], atol=6e-7)


def test_printed_matrices_lose_stable_points() -> None:
    """With unequal pendulums the printed matrices leave none of the stable points B, C, E; (4-6) alone loses B."""
    unequal = misprint_numbers.type_i_multipliers(0.055)
    stable = [value < 1 for value in unequal["derived"]]
    assert stable == [False, True, True, False, True]
    assert min(unequal["(4-15), (4-16), (4-17) as printed"]) > 1
    assert misprint_numbers.type_i_multipliers(0.075)["(4-6) as printed, linearised"][1] > 1


def test_sampling_the_piecewise_matrix_elsewhere_changes_nothing() -> None:
    errors, sampling = misprint_numbers.piecewise_errors(50)
    assert sampling < 1e-11
    assert min(errors) > 1e-5


@pytest.mark.parametrize("locked", [True, False])
def test_run_up_equations_without_faults_are_the_kernels(locked: bool) -> None:
    rng = np.random.default_rng(4)
    p = rig(zeta=0.05, mass_b_kg=0.04)
    for _ in range(20):
        y = rng.normal(size=8) * [1e-2, 1e-2, 3, 3, 0.5, 0.5, 20, 20]
        psi, omega = rng.normal(size=2) * [3, 60]
        expected, found = np.empty(8), np.empty(8)
        rates(y, psi, omega, 0.0, p.packed(), 1.0 - locked, 1.0 - locked, expected)
        script_rates(y, psi, omega, p.packed(), locked, False, False, found)
        assert np.allclose(found, expected, rtol=1e-11, atol=1e-10)


def test_run_up_equations_with_fault_a_are_the_listings() -> None:
    """The faulty accelerations, turned into the rotor's frame, satisfy what the listing evaluates."""
    p = rig(zeta=0.05, mass_b_kg=0.04)
    y = np.array([4e-3, -2e-3, 0.4, 2.2, 0.1, 0.3, 5.0, -3.0])
    psi, omega, out = 0.7, 40.0, np.empty(8)
    script_rates(y, psi, omega, p.packed(), False, True, False, out)
    back = np.exp(-1j * psi)
    z = (y[0] + 1j * y[1]) * back
    dz = (y[4] + 1j * y[5]) * back - 1j * omega * z
    ddz = (out[4] + 1j * out[5]) * back - 2j * omega * dz + omega**2 * z
    values = rig_values(p) | {
        s.M_S: p.total_mass_kg,
        s.S_A: p.a.first_moment_kg_m,
        s.S_B: p.b.first_moment_kg_m,
        s.alpha: 0,
        s.psi: psi,
        s.omega: omega,
        s.Y1: z.real,
        s.Y2: z.imag,
        s.theta3: y[2],
        s.theta4: y[3],
        s.dY1: dz.real,
        s.dY2: dz.imag,
        s.dtheta3: y[6],
        s.dtheta4: y[7],
        s.ddY1: ddz.real,
        s.ddY2: ddz.imag,
    }
    listed = source_listing.residuals()
    disk = listed[:2, :].subs(source_listing.NOT_YET_COMPUTED).subs(values)
    pendulums = listed[2:, :].subs(values | {s.ddtheta3: out[6], s.ddtheta4: out[7]})
    size = p.k2_N_per_m * abs(z)
    assert np.allclose(np.array(disk, float), 0, atol=1e-12 * size)
    assert np.allclose(np.array(pendulums, float), 0, atol=1e-12 * size)


def test_the_run_up_faults_show() -> None:
    """A locked pendulum gathers speed only with fault (b); only fault (a) shifts where wobbling pendulums settle."""
    p = rig()
    runs = {
        faults: release(p, p.speed_rad_s(POINTS["D"]), faults, 5.0, 20.0, 100)
        for faults in (
            PrintedFaults(),
            PrintedFaults(without_reaction=True),
            PrintedFaults(integrates_locked_speed=True),
        )
    }
    right, without_reaction, runs_on = runs.values()
    assert right.speed_at_release_rad_s == without_reaction.speed_at_release_rad_s == (0.0, 0.0)
    assert runs_on.speed_at_release_rad_s[0] < -1.0
    shift = np.degrees(without_reaction.final_angles_rad - right.final_angles_rad)
    assert np.allclose(shift, 1.2, atol=0.1)
    assert np.allclose(runs_on.final_angles_rad, right.final_angles_rad, atol=1e-4)
