"""Coverage factors, intervals of a sample and their numerical error, the numerical tolerance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtri

from uncertainty import BadInput, coverage_factor, ellipsoid_factor, numerical_tolerance
from uncertainty.coverage import end_errors, shortest_interval, symmetric_interval

LEVELS = st.sampled_from([0.5, 0.6827, 0.9, 0.95, 0.99])


@pytest.mark.parametrize(
    ("level", "nu", "k"),  # JCGM 100, table G.2
    [(0.95, 1, 12.71), (0.95, 4, 2.78), (0.99, 16, 2.92), (0.9545, 50, 2.05), (0.95, math.inf, 1.960)],
)
def test_students_factor(level: float, nu: float, k: float) -> None:
    assert coverage_factor(level, nu) == pytest.approx(k, abs=0.006)


@pytest.mark.parametrize(("dimension", "k"), [(1, 1.96), (2, 2.45), (3, 2.80), (4, 3.08)])
def test_ellipsoid_factor(dimension: int, k: float) -> None:
    """JCGM 102, table 2."""
    assert ellipsoid_factor(0.95, dimension) == pytest.approx(k, abs=0.006)


@pytest.mark.parametrize(
    ("std", "digits", "tolerance"),  # the first two: JCGM 101, 7.9.2
    [(0.00035, 2, 0.5e-5), (0.00035, 1, 0.5e-4), (0.0996, 2, 0.5e-2), (0.0994, 2, 0.5e-3), (10.1, 2, 0.5), (0, 2, 0)],
)
def test_numerical_tolerance(std: float, digits: int, tolerance: float) -> None:
    assert numerical_tolerance(std, digits) == pytest.approx(tolerance)


@given(st.floats(1e-290, 1e290), st.integers(1, 6))
def test_numerical_tolerance_is_half_a_unit_in_the_last_digit(std: float, digits: int) -> None:
    units = std / (2 * numerical_tolerance(std, digits))
    assert 10 ** (digits - 1) * (1 - 1e-9) - 0.5 <= units <= 10**digits * (1 + 1e-9)


@given(st.lists(st.floats(-1e6, 1e6), min_size=120, max_size=300), LEVELS)
def test_intervals_hold_their_share(values: list[float], level: float) -> None:
    ordered = np.sort(values)
    symmetric, shortest = symmetric_interval(ordered, level), shortest_interval(ordered, level)
    steps = math.floor(level * len(ordered) + 0.5)
    for low, high in (symmetric, shortest):
        assert np.count_nonzero((ordered >= low) & (ordered <= high)) >= steps + 1
    assert shortest[1] - shortest[0] == min(b - a for a, b in zip(ordered, ordered[steps:], strict=False))
    below, above = np.count_nonzero(ordered < symmetric[0]), np.count_nonzero(ordered > symmetric[1])
    if len(set(values)) == len(values):
        assert abs(int(below) - int(above)) <= 1


def test_intervals_of_a_skew_sample() -> None:
    ordered = -np.log(1 - (np.arange(100_000) + 0.5) / 100_000)  # exponential
    assert symmetric_interval(ordered, 0.95) == pytest.approx((0.0253, 3.689), abs=1e-3)
    assert shortest_interval(ordered, 0.95) == pytest.approx((0.0, 2.996), abs=1e-3)


def test_numerical_error_of_the_ends_is_two_standard_deviations() -> None:
    generator = np.random.default_rng(21)
    ends, errors = [], []
    for _ in range(1000):
        ordered = np.sort(generator.standard_normal(2000))
        ends.append(symmetric_interval(ordered, 0.95)[1])
        errors.append(end_errors(ordered, 0.95)[1])
    assert np.mean(errors) == pytest.approx(2 * np.std(ends), rel=0.1)
    assert np.mean(np.abs(np.array(ends) - ndtri(0.975)) <= errors) == pytest.approx(0.95, abs=0.025)


def test_numerical_error_is_infinite_where_the_sample_ends() -> None:
    assert end_errors(np.arange(100.0), 0.95) == (math.inf, math.inf)
    assert all(math.isfinite(e) for e in end_errors(np.arange(1000.0), 0.95))


def test_refused() -> None:
    for level in (0.0, 1.0, 1.5, math.nan):
        with pytest.raises(BadInput):
            coverage_factor(level)
    for nu in (0.0, -1.0, math.nan):
        with pytest.raises(BadInput):
            coverage_factor(0.95, nu)
    with pytest.raises(BadInput):
        ellipsoid_factor(0.95, 0)
    for std, digits in ((1.0, 0), (-1.0, 2), (math.inf, 2), (math.nan, 2)):
        with pytest.raises(BadInput):
            numerical_tolerance(std, digits)
    with pytest.raises(BadInput):
        symmetric_interval(np.arange(5.0), 0.95)
    with pytest.raises(BadInput):
        shortest_interval(np.arange(5.0), 0.01)
