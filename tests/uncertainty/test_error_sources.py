"""Sources and groups of errors: what they draw, what they refuse, how they are made of readings and limits."""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from uncertainty import BadInput, ErrorSource, Group, coverage_factor, reliability_degrees
from uncertainty.source import Distribution

N = 200_000
EXTREME = {"rectangular": math.sqrt(3), "triangular": math.sqrt(6), "arcsine": math.sqrt(2)}
FOURTH = {"normal": 3.0, "rectangular": 1.8, "triangular": 2.4, "arcsine": 1.5}  # moment over the variance squared


@pytest.mark.parametrize("distribution", FOURTH)
def test_draws_have_mean_zero_the_standard_uncertainty_and_the_shape(distribution: Distribution) -> None:
    drawn = ErrorSource("a", 0.3, "m", "B", distribution).draw(np.random.default_rng(11), N) / 0.3
    assert drawn.shape == (N,)
    assert np.mean(drawn) == pytest.approx(0, abs=0.01)
    assert np.std(drawn) == pytest.approx(1, abs=0.01)
    assert np.mean(drawn**4) == pytest.approx(FOURTH[distribution], rel=0.02)
    if distribution in EXTREME:
        assert np.max(np.abs(drawn)) <= EXTREME[distribution] * (1 + 1e-12)
        assert np.max(np.abs(drawn)) >= 0.98 * EXTREME[distribution]


@pytest.mark.parametrize("nu", [2.0, 4.0, 30.0])
def test_draws_of_t_have_students_interval(nu: float) -> None:
    drawn = ErrorSource("a", 2.0, "m", "A", "t", nu).draw(np.random.default_rng(12), N)
    inside = np.mean(np.abs(drawn) <= 2.0 * coverage_factor(0.95, nu))
    assert inside == pytest.approx(0.95, abs=0.002)


def test_t_of_infinite_degrees_is_normal() -> None:
    drawn = ErrorSource("a", 1.0, distribution="t").draw(np.random.default_rng(13), N)
    assert np.mean(drawn**4) == pytest.approx(3, rel=0.03)


def test_every_distribution_is_tested() -> None:
    assert set(get_args(Distribution)) == {*FOURTH, "t"}


def test_readings() -> None:
    source = ErrorSource.of_readings("a", [1.0, 2.0, 3.0, 4.0], "m")
    assert source.std == pytest.approx(math.sqrt(5 / 3) / 2)
    assert (source.degrees_of_freedom, source.kind, source.distribution, source.unit) == (3, "A", "t", "m")


@pytest.mark.parametrize("distribution", EXTREME)
def test_half_width(distribution: Distribution) -> None:
    source = ErrorSource.of_half_width("a", 0.5, "m", distribution)
    assert source.std * EXTREME[distribution] == pytest.approx(0.5)
    assert np.max(np.abs(source.draw(np.random.default_rng(1), 1000))) <= 0.5 * (1 + 1e-12)


@pytest.mark.parametrize(("relative", "nu"), [(0.1, 50), (0.25, 8), (0.5, 2), (0.0, math.inf)])
def test_reliability(relative: float, nu: float) -> None:
    assert reliability_degrees(relative) == pytest.approx(nu)


@pytest.mark.parametrize(
    "fields",
    [
        {"name": ""},
        {"std": -1.0},
        {"std": math.nan},
        {"std": math.inf},
        {"kind": "C"},
        {"distribution": "gaussian"},
        {"degrees_of_freedom": 0.0},
        {"degrees_of_freedom": math.nan},
    ],
)
def test_source_refuses(fields: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        ErrorSource(**({"name": "a", "std": 1.0} | fields))


@pytest.mark.parametrize(
    "make",
    [
        lambda: ErrorSource.of_readings("a", [1.0]),
        lambda: ErrorSource.of_readings("a", [1.0, math.nan]),
        lambda: ErrorSource.of_half_width("a", 1.0, "m", "normal"),
        lambda: ErrorSource.of_half_width("a", -1.0),
        lambda: reliability_degrees(-0.1),
        lambda: Group("g", (), (), np.zeros((0, 0))),
        lambda: Group("g", ("x", "x"), ("m", "m"), np.eye(2)),
        lambda: Group("g", ("x", "y"), ("m",), np.eye(2)),
        lambda: Group("g", ("x", "y"), ("m", "m"), np.eye(3)),
        lambda: Group("g", ("x", "y"), ("m", "m"), np.array([[1.0, 0.5], [0.4, 1.0]])),
        lambda: Group("g", ("x", "y"), ("m", "m"), np.array([[1.0, 2.0], [2.0, 1.0]])),
        lambda: Group("g", ("x", "y"), ("m", "m"), np.array([[1.0, 1.0], [1.0, 0.0]])),
        lambda: Group("g", ("x", "y"), ("m", "m"), np.array([[1.0, 1e-12], [1e-12, 0.0]])),
        lambda: Group("g", ("x",), ("m",), np.array([[math.nan]])),
        lambda: Group("g", ("x",), ("m",), np.array([[-1.0]])),
        lambda: Group.of_observations("g", ["x"], ["m"], [[1.0]]),
        lambda: Group.of_observations("g", ["x"], ["m"], [1.0, 2.0]),
    ],
)
def test_refused(make: Any) -> None:
    with pytest.raises(BadInput):
        make()


@given(arrays(np.int64, (3, 3), elements=st.integers(-1000, 1000)), st.integers(-9, 9))
def test_factor_gives_the_covariance_back(root: np.ndarray, decade: int) -> None:
    scale = np.array([1.0, 10.0**decade, 1.0])  # members in units of very unlike size
    covariance = (root @ root.T) * np.outer(scale, scale)
    group = Group("g", ("x", "y", "z"), ("m", "V", "rad"), covariance)
    std = group.std
    assert np.all(np.abs(group.factor @ group.factor.T - covariance) <= 1e-7 * np.outer(std, std) + 1e-300)


def test_singular_group_draws_on_its_line() -> None:
    group = Group("g", ("x", "y"), ("m", "m"), np.array([[4.0, -2.0], [-2.0, 1.0]]))
    drawn = group.draw(np.random.default_rng(14), 1000)
    assert drawn[:, 0] == pytest.approx(-2 * drawn[:, 1], abs=1e-6)


def test_group_draws_its_covariance_and_t_wider_by_its_degrees() -> None:
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    for distribution, nu, stretch in (("normal", 8.0, 1.0), ("t", 8.0, 8 / 6), ("t", math.inf, 1.0)):
        group = Group("g", ("x", "y"), ("m", "m"), covariance, "A", distribution, nu)
        drawn = group.draw(np.random.default_rng(15), N)
        assert np.cov(drawn, rowvar=False) == pytest.approx(stretch * covariance, rel=0.03)
    both = np.mean(np.abs(drawn[:, 0]) > 6)  # 3 u: normal 0.0027
    assert both == pytest.approx(0.0027, abs=0.0006)


def test_arrays_of_a_group_cannot_change() -> None:
    given_matrix = np.eye(2)
    group = Group("g", ("x", "y"), ("m", "m"), given_matrix)
    given_matrix[0, 0] = 5.0
    assert group.std == pytest.approx([1, 1])
    with pytest.raises(ValueError, match="read-only"):
        group.covariance[0, 0] = 2.0
