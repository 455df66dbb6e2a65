"""What makes single multipliers and steady states quick: compiled pieces against plain ones."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dynamics.equations.balancing import balancing_region
from dynamics.equations.kernels import FA, FB, jacobian
from dynamics.equations.linearised import PeriodicMatrix
from dynamics.equations.quick_derivatives import rate_derivatives
from dynamics.stability.floquet import METHODS
from dynamics.stability.floquet.bounds import balancing_units
from dynamics.steady.harmonic_balance import Grid, _eliminate, _scale_rows
from tests.dynamics.nominal import from_domain

ROOT = Path(__file__).parents[2]
SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.integers(2, 12))
def test_balancing_brings_rows_and_columns_to_like_size(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-6, 6, n)
    size = np.abs(rng.normal(size=(n, n))) * scale / scale[:, None]
    unit = balancing_units(size)
    assert np.array_equal(np.log2(unit), np.round(np.log2(unit)))
    apart = size * unit / unit[:, None] * (1 - np.eye(n))
    ratio = np.linalg.norm(apart, axis=0) / np.linalg.norm(apart, axis=1)
    assert np.all((ratio > 0.3) & (ratio < 3.5))


def test_balancing_leaves_a_state_that_nothing_couples_alone() -> None:
    assert np.array_equal(balancing_units(np.diag([1.0, 1e6, 0.0])), np.ones(3))
    assert np.array_equal(balancing_units(np.array([[0.0, 1.0], [0.0, 0.0]])), np.ones(2))


@given(SEEDS, st.integers(1, 40))
@settings(deadline=None)
def test_elimination_solves_what_lapack_solves(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, right = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-9, 9, (n, 1)), rng.normal(size=n)
    found, scaled = right.copy(), matrix.copy()
    assert _scale_rows(scaled, found)
    assert _eliminate(scaled, found)
    whole = matrix / np.max(np.abs(matrix), axis=1)[:, None]
    rest = whole @ found - right / np.max(np.abs(matrix), axis=1)
    assert np.max(np.abs(rest)) <= 1e-12 * np.max(np.abs(found))


@pytest.mark.parametrize("spoiled", [0.0, np.nan, np.inf])
def test_a_system_without_a_solution_is_refused(spoiled: float) -> None:
    matrix = np.array([[1.0, 2.0], [spoiled, spoiled]])
    assert not _scale_rows(matrix.copy(), np.ones(2))
    assert not _eliminate(np.array([[1.0, 2.0], [0.5, 1.0]]), np.ones(2))


@given(SEEDS, st.booleans(), st.booleans())
def test_closed_derivatives_are_those_of_the_kernel(seed: int, free_a: bool, free_b: bool) -> None:
    rng = np.random.default_rng(seed)
    p, ratio = from_domain(rng)
    p = dataclasses.replace(
        p, gravity_m_per_s2=9.81, bow_x_m=1e-3, hardening_per_m2=(1e3, -1e2), damping_growth_s_per_m=(3.0, 0.0)
    )
    packed, speed = p.packed(), p.speed_rad_s(ratio)
    packed[FA] = packed[FB] = 0.0
    state = rng.normal(size=8) * [1e-3, 1e-3, 3, 3, 0.1, 0.1, 0.3 * speed, 0.3 * speed]
    state[6:] *= [free_a, free_b]
    exact, found = np.empty((8, 8)), np.empty((4, 8))
    arguments = (float(free_a), float(free_b))
    jacobian(state, 0.7, speed, 0.0, packed, *arguments, exact)
    rate_derivatives(state, 0.7, speed, packed, *arguments, found)
    size = np.abs(exact[4:]).max(axis=1, keepdims=True)
    assert np.all(np.abs(found - exact[4:]) <= 1e-11 * size)


def test_matrices_wider_than_the_columns_side_by_side() -> None:
    rng = np.random.default_rng(5)
    harmonics = rng.normal(size=(4, 11, 11)) + 1j * rng.normal(size=(4, 11, 11))
    matrix = PeriodicMatrix(0.1 * harmonics, 1.0, None)
    found, other = (METHODS[name].monodromy(matrix, steps) for name, steps in (("explicit", 200), ("chebyshev", 12)))
    assert np.max(np.abs(found - other)) < 1e-9 * np.max(np.abs(other))


@given(SEEDS)
def test_regions_are_those_of_exact_arithmetic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = 10.0 ** rng.uniform(-6, 0, 2)
    border = rng.choice([a + b, abs(a - b)])
    s = float(border * (1 + rng.integers(-4, 5) * 1.2e-16))
    exact = [Fraction(b) + Fraction(s) - Fraction(a), Fraction(a) + Fraction(s) - Fraction(b)]
    whole = Fraction(a) + Fraction(b) - Fraction(s)
    rounding = Fraction(np.spacing(max(a, b, s)))
    expected = "properly oversized" if min(*exact, whole) >= -rounding else "undersized"
    if expected == "undersized" and whole >= -rounding:
        expected = "improperly oversized"
    assert balancing_region(a, b, s) == expected


@pytest.mark.parametrize("symmetric", [True, False])
def test_coefficients_give_back_the_samples(symmetric: bool) -> None:
    def motion(phase: np.ndarray) -> np.ndarray:
        x, angle = 0.3 * np.cos(phase) - 0.1 * np.sin(3 * phase), 0.2 + 0.05 * np.sin(2 * phase)
        return np.column_stack([x, 2 * x, angle, -angle])

    grid = Grid.of(8, symmetric)
    c = grid.coefficients(motion(2 * np.pi * np.arange(40) / 40))
    bases = (grid.position, grid.position, grid.angle, grid.angle)
    again = np.column_stack([basis.value @ c[:, i] for i, basis in enumerate(bases)])
    assert np.allclose(again, motion(grid.phase), atol=1e-14)


WITHOUT_SCIPY = """
import sys
from dynamics.compiled_code import keep_compiled_code, load_compiler
keep_compiled_code()
load_compiler()
from dynamics import multipliers, steady_states
from tests.dynamics.nominal import rig
speed = rig().speed_rad_s(1.6)
found = len(steady_states(rig(), speed)), multipliers(rig(), speed).stable
print(*found, "scipy.linalg" in sys.modules)
from dynamics.stability.floquet import METHODS
from dynamics.equations.linearised import type_one
print(METHODS["implicit"].monodromy(type_one(rig(), 1.9, 4.4, speed), 8).shape, "scipy.linalg" in sys.modules)
"""


def test_steady_states_do_not_wait_for_scipy_and_lapack_is_there_when_called() -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_SCIPY], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["6 True False", "(8, 8) True"]
