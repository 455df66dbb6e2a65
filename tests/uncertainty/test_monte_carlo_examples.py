"""Worked examples of JCGM 101: added inputs (9.2), mass calibration (9.3), gauge block (9.5)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from tests.uncertainty.gum_models import (
    EXPANSION,
    GAUGE,
    MEAN_TEMPERATURE,
    OBSERVATIONS,
    STANDARD_NM,
    gauge_length,
    impedance,
)
from uncertainty import Budgets, ErrorSource, Group, check_linear, linear_budgets, monte_carlo, second_order_variance
from uncertainty.source import Distribution

TRIALS = 400_000

MASS = [
    ErrorSource("reference weight", 0.050, "mg"),
    ErrorSource("added weight", 0.020, "mg"),
    ErrorSource.of_half_width("density of air", 0.10, "kg/m³"),
    ErrorSource.of_half_width("density of the weight", 1000.0, "kg/m³"),
    ErrorSource.of_half_width("density of the reference", 50.0, "kg/m³"),
]


def total(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sum(errors, axis=1, keepdims=True)


def mass_off_nominal(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Formula 31 of JCGM 101: conventional mass off 100 g, mg."""
    reference, added, air, weight, standard = errors.T
    buoyancy = air * (1 / (8000 + weight) - 1 / (8000 + standard))
    return ((100_000.000 + reference + 1.234 + added) * (1 + buoyancy) - 100_000.000)[:, None]


def four(distribution: Distribution, last: float = 1.0) -> list[ErrorSource]:
    return [ErrorSource(f"X{i}", std, "", "B", distribution) for i, std in enumerate((1.0, 1.0, 1.0, last), start=1)]


def budgets_of_sum(sources: list[ErrorSource]) -> Budgets:
    return Budgets(("sum",), np.zeros(1), ("",), tuple(sources), np.ones((1, 4)))


def rectangular_sum_quantile(level: float) -> float:
    """Upper end of the symmetric interval of four rectangular errors of standard deviation 1 (Irwin and Hall)."""
    width = 2 * math.sqrt(3)

    def above(y: float) -> float:
        x = y / width + 2
        return 1 - sum((-1) ** k * math.comb(4, k) * (x - k) ** 4 for k in range(int(x) + 1)) / 24

    low, high = 0.0, 2 * width
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if above(middle) > 0.5 * (1 - level) else (low, middle)
    return low


def test_normal_inputs_added() -> None:
    found = monte_carlo(total, four("normal"), seed=1, trials=TRIALS)
    y = found.quantities[0]
    assert y.mean == pytest.approx(0, abs=0.015)
    assert y.std == pytest.approx(2.0, abs=0.01)
    assert y.symmetric == pytest.approx((-3.92, 3.92), abs=0.03)
    assert y.shortest == pytest.approx((-3.92, 3.92), abs=0.12)
    assert budgets_of_sum(four("normal"))["sum"].interval() == pytest.approx((-3.92, 3.92), abs=0.005)


def test_rectangular_inputs_added() -> None:
    assert rectangular_sum_quantile(0.95) == pytest.approx(3.88, abs=0.005)
    found = monte_carlo(total, four("rectangular"), seed=2, trials=TRIALS)
    y = found.quantities[0]
    assert y.std == pytest.approx(2.0, abs=0.01)
    assert y.symmetric == pytest.approx((-3.88, 3.88), abs=0.03)
    assert y.shortest == pytest.approx((-3.88, 3.88), abs=0.12)
    assert y.shortest[1] - y.shortest[0] == pytest.approx(2 * 3.88, abs=0.04)
    budget = budgets_of_sum(four("rectangular"))["sum"]
    assert check_linear(budget, found, digits=1).verdict == "agree"  # δ = 0.5
    check = check_linear(budget, found, digits=2)  # δ = 0.05, d = 0.04
    assert check.tolerance == pytest.approx(0.05)
    assert (check.low, check.high) == pytest.approx((0.04, 0.04), abs=0.03)


def test_one_rectangular_input_dominates() -> None:
    """9.2.4: u = 10.1, linear ± 19.9, distribution ± 17.0; the linear interval is refused."""
    found = monte_carlo(total, four("rectangular", 10.0), seed=3, trials=TRIALS)
    budget = budgets_of_sum(four("rectangular", 10.0))["sum"]
    assert budget.std == pytest.approx(10.1, abs=0.05)
    assert budget.interval() == pytest.approx((-19.9, 19.9), abs=0.05)
    assert found.quantities[0].std == pytest.approx(10.1, abs=0.05)
    assert found.quantities[0].symmetric == pytest.approx((-17.0, 17.0), abs=0.08)
    check = check_linear(budget, found)
    assert check.tolerance == 0.5
    assert (check.low, check.high) == pytest.approx((2.8, 2.8), abs=0.15)
    assert check.verdict == "differ"


def test_mass_calibration() -> None:
    """Table 7 of JCGM 101: u 0.0539 to first order, 0.0750 with second order terms, 0.0754 by Monte Carlo."""
    budget = linear_budgets(mass_off_nominal, MASS, ["mass"], ["mg"])["mass"]
    assert budget.value == pytest.approx(1.2340, abs=5e-5)
    assert budget.std == pytest.approx(0.0539, abs=5e-5)
    assert budget.interval() == pytest.approx((1.1285, 1.3395), abs=1e-4)
    second = float(second_order_variance(mass_off_nominal, MASS)[0])
    assert math.sqrt(budget.std**2 + second) == pytest.approx(0.0750, abs=1.5e-3)

    found = monte_carlo(mass_off_nominal, MASS, seed=4, trials=TRIALS, names=["mass"])
    assert found["mass"].mean == pytest.approx(1.2341, abs=5e-4)
    assert found["mass"].std == pytest.approx(0.0754, abs=4e-4)
    low, high = found["mass"].shortest  # many intervals are nearly as short: the ends scatter, the length does not
    assert (low, high) == pytest.approx((1.0834, 1.3825), abs=5e-3)
    assert high - low == pytest.approx(1.3825 - 1.0834, abs=1.5e-3)
    check = check_linear(budget, found, digits=1)
    assert check.tolerance == pytest.approx(0.005)
    assert (check.low, check.high) == pytest.approx((0.0451, 0.0430), abs=2.5e-3)
    assert check.verdict == "differ"


def test_gauge_block() -> None:
    """9.5: mean 838, u 36, 99 % interval 745 … 932 nm, with limits that are themselves inexact."""
    sources = [*GAUGE[:7]]
    for name, unit in (("difference of expansions", "1/°C"), ("difference of temperatures", "°C")):
        sources += [
            ErrorSource.of_half_width(f"{name}, shape", 1.0),
            ErrorSource.of_half_width(f"{name}, limit", 1.0, unit),
        ]

    def with_inexact_limits(errors: NDArray[np.float64]) -> NDArray[np.float64]:
        expansions = errors[:, 7] * (1e-6 + 0.1e-6 * errors[:, 8])
        temperatures = errors[:, 9] * (0.050 + 0.025 * errors[:, 10])
        return gauge_length(np.column_stack([errors[:, :7], expansions, temperatures])) - 50_000_000.0

    found = monte_carlo(with_inexact_limits, sources, seed=5, trials=TRIALS, level=0.99).quantities[0]
    assert found.mean == pytest.approx(838, abs=0.5)
    assert found.std == pytest.approx(36, abs=0.7)
    assert found.symmetric == pytest.approx((745, 932), abs=2.0)
    assert abs(EXPANSION * MEAN_TEMPERATURE * STANDARD_NM) > 50  # the temperature matters to the figures above


def test_resistance_and_reactance_as_joint_t() -> None:
    """H.2 with a multivariate t: the intervals are Student's, and Z keeps to sqrt(R² + X²) in every trial."""
    group = Group.of_observations("readings", ["V", "I", "phase"], ["V", "A", "rad"], OBSERVATIONS)
    budgets = linear_budgets(impedance, [group], ["R", "X", "Z"], ["Ω"] * 3)
    found = monte_carlo(impedance, [group], seed=6, trials=TRIALS, names=budgets.names)
    for budget in budgets.budgets:
        assert found[budget.name].symmetric == pytest.approx(budget.interval(), abs=0.03 * budget.std)
        assert check_linear(budget, found, digits=1).verdict == "agree"
    assert found.correlation == pytest.approx(budgets.correlation, abs=0.02)


def test_normal_sum_holds_what_it_states() -> None:
    found = monte_carlo(total, four("normal"), seed=8, trials=TRIALS, level=0.9)
    low, high = (float(ndtr(end / 2.0)) for end in found.quantities[0].symmetric)
    assert (low, high) == pytest.approx((0.05, 0.95), abs=0.002)
