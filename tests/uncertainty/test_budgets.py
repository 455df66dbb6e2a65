"""Budgets of one and of several quantities: variance, shares, degrees of freedom, covariance, JSON."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from uncertainty import BadInput, Budget, Budgets, Contribution, ErrorSource, Group, GroupContribution

SIZES = st.floats(1e-3, 1e3)
SIGNED = st.one_of(SIZES, SIZES.map(lambda x: -x))
DEGREES = st.one_of(st.just(math.inf), st.floats(1, 1e6))
ROWS = st.lists(st.tuples(SIZES, SIGNED, DEGREES), min_size=1, max_size=8)
Row = tuple[float, float, float]


def budget_of(rows: list[Row], scale: float = 1.0) -> Budget:
    return Budget(
        "q",
        1.0,
        "m",
        tuple(
            Contribution(ErrorSource(f"s{i}", u, degrees_of_freedom=nu), scale * c) for i, (u, c, nu) in enumerate(rows)
        ),
    )


@given(ROWS)
def test_variance_is_the_sum_of_squares_and_shares_sum_to_one(rows: list[Row]) -> None:
    budget = budget_of(rows)
    assert budget.std**2 == pytest.approx(sum((c * u) ** 2 for u, c, _ in rows))
    assert sum(budget.shares.values()) == pytest.approx(1)
    for (u, c, _), share in zip(rows, budget.shares.values(), strict=True):
        assert share == pytest.approx((c * u / budget.std) ** 2)


@given(ROWS)
def test_effective_degrees_lie_between_the_smallest_and_the_sum(rows: list[Row]) -> None:
    degrees = budget_of(rows).degrees_of_freedom
    each = [nu for _, _, nu in rows]
    assert min(each) * (1 - 1e-9) <= degrees <= sum(each) * (1 + 1e-9)


@given(st.lists(st.tuples(SIZES, SIGNED, st.floats(1, 100)), min_size=2, max_size=5))
def test_welch_satterthwaite(rows: list[Row]) -> None:
    variance = sum((c * u) ** 2 for u, c, _ in rows)
    expected = variance**2 / sum((c * u) ** 4 / nu for u, c, nu in rows)
    assert budget_of(rows).degrees_of_freedom == pytest.approx(expected)


def test_two_equal_terms_have_the_sum_of_their_degrees() -> None:
    assert budget_of([(1, 1, 5), (1, -1, 5)]).degrees_of_freedom == pytest.approx(10)
    assert budget_of([(1, 1, 5), (1e-9, 1, 1)]).degrees_of_freedom == pytest.approx(5)
    assert math.isinf(budget_of([(1, 1, math.inf)]).degrees_of_freedom)


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1e200])
def test_very_small_and_large_quantities(scale: float) -> None:
    rows = [(1.0, 3.0, 4.0), (2.0, -2.0, 9.0)]
    budget = budget_of(rows, scale)
    assert budget.std == pytest.approx(5 * scale, rel=1e-12)
    assert budget.degrees_of_freedom == pytest.approx(budget_of(rows).degrees_of_freedom)
    assert budget.shares == pytest.approx({"s0": 0.36, "s1": 0.64})


def test_expanded_uncertainty() -> None:
    budget = budget_of([(0.5, 2.0, 4.0)])
    assert budget.coverage_factor() == pytest.approx(2.776, abs=5e-4)
    assert budget.expanded(0.99) == pytest.approx(4.604, abs=5e-4)
    assert budget.interval() == pytest.approx((1 - 2.776, 1 + 2.776), abs=1e-3)
    assert budget_of([(0.5, 2.0, math.inf)]).expanded() == pytest.approx(1.960, abs=5e-4)


def test_quantity_without_error() -> None:
    for budget in (budget_of([(0.0, 1.0, 3.0)]), Budget("q", 2.0, "m", ())):
        assert budget.std == 0
        assert sum(budget.shares.values()) == 0
        assert math.isinf(budget.degrees_of_freedom)
        assert budget.interval() == (budget.value, budget.value)


PAIR = Group("pair", ("x", "y"), ("m", "V"), np.array([[4.0, 1.5], [1.5, 1.0]]), degrees_of_freedom=6)


def test_group_is_one_term() -> None:
    budget = Budget("q", 0.0, "m", (GroupContribution(PAIR, (1.0, -2.0)), Contribution(ErrorSource("s", 1.0), 1.0)))
    of_group = 4.0 + 4 * 1.0 - 4 * 1.5
    assert budget.std**2 == pytest.approx(of_group + 1)
    assert budget.shares == pytest.approx({"pair": of_group / (of_group + 1), "s": 1 / (of_group + 1)})
    assert budget.degrees_of_freedom == pytest.approx((of_group + 1) ** 2 / (of_group**2 / 6))
    cancelled = GroupContribution(Group("g", ("x", "y"), ("", ""), np.ones((2, 2))), (1.0, -1.0))
    assert cancelled.std == pytest.approx(0, abs=1e-7)


@st.composite
def tables(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Sensitivities (quantities, sources) and standard uncertainties (sources,)."""
    quantities, sources = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    row = st.lists(st.floats(-100, 100), min_size=sources, max_size=sources)
    table = draw(st.lists(row, min_size=quantities, max_size=quantities))
    std = draw(st.lists(st.floats(0, 100), min_size=sources, max_size=sources))
    return np.array(table), np.array(std)


@given(tables())
def test_covariance_is_that_of_the_table(case: tuple[np.ndarray, np.ndarray]) -> None:
    table, std = case
    names = tuple(f"q{i}" for i in range(len(table)))
    sources = tuple(ErrorSource(f"s{j}", float(u)) for j, u in enumerate(std))
    budgets = Budgets(names, np.zeros(len(table)), ("m",) * len(table), sources, table)
    expected = table @ np.diag(std**2) @ table.T
    assert budgets.covariance == pytest.approx(expected, rel=1e-9, abs=1e-9)
    for i, budget in enumerate(budgets.budgets):
        assert budget.std**2 == pytest.approx(float(budgets.covariance[i, i]), rel=1e-9)
        assert [c.signed for c in budget.contributions] == pytest.approx((table[i] * std).tolist())
    correlation = budgets.correlation
    assert np.all(np.diag(correlation) == 1)
    length = np.sqrt(np.diag(expected))
    assert correlation * np.outer(length, length) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(tables())
def test_contributions_instead_of_sensitivities(case: tuple[np.ndarray, np.ndarray]) -> None:
    table, std = case
    names = [f"q{i}" for i in range(len(table))]
    sources = [ErrorSource(f"s{j}", float(u) + 0.1) for j, u in enumerate(std)]
    budgets = Budgets.of_contributions(names, np.ones(len(table)), ["m"] * len(table), sources, table)
    assert budgets.covariance == pytest.approx(table @ table.T, rel=1e-9, abs=1e-9)


def test_groups_among_the_sources() -> None:
    table = np.array([[1.0, 2.0, 3.0, 0.0], [0.0, -1.0, 1.0, 5.0]])
    sources = (ErrorSource("a", 0.5), PAIR, ErrorSource("b", 2.0, degrees_of_freedom=3))
    budgets = Budgets(("q", "r"), np.array([1.0, 2.0]), ("m", "s"), sources, table)
    middle = np.zeros((4, 4))
    middle[0, 0], middle[3, 3] = 0.25, 4.0
    middle[1:3, 1:3] = PAIR.covariance
    assert budgets.covariance == pytest.approx(table @ middle @ table.T)
    assert [c.name for c in budgets["r"].contributions] == ["a", "pair", "b"]
    assert budgets["q"].std ** 2 == pytest.approx(budgets.covariance[0, 0])


def test_shared_source_cancels_in_a_difference() -> None:
    sources = (ErrorSource("shared", 3.0), ErrorSource("own q", 1.0), ErrorSource("own r", 2.0))
    budgets = Budgets(("q", "r"), np.array([5.0, 4.0]), ("m", "m"), sources, np.array([[1.0, 1, 0], [1, 0, 1]]))
    assert budgets.correlation[0, 1] == pytest.approx(9 / math.sqrt(10 * 13))
    difference = budgets.derived(["q - r"], [1.0], ["m"], [[1.0, -1.0]])["q - r"]
    assert difference.value == 1
    assert difference.std == pytest.approx(math.sqrt(5))
    assert difference.shares["shared"] == pytest.approx(0)


def test_derived_quantities_follow_the_chain_rule() -> None:
    table = np.array([[1.0, -2.0, 3.0, 0.5], [0.0, -1.0, 1.0, -5.0]])
    sources = (ErrorSource("a", 0.5), PAIR, ErrorSource("b", 2.0))
    budgets = Budgets(("q", "r"), np.array([1.0, 2.0]), ("m", "s"), sources, table)
    jacobian = np.array([[2.0, -1.0], [0.0, 3.0], [1.0, 1.0]])
    derived = budgets.derived(["u", "v", "w"], [0.0, 6.0, 3.0], ["m", "s", "m"], jacobian)
    assert derived.sensitivities == pytest.approx(jacobian @ table)
    assert derived.covariance == pytest.approx(jacobian @ budgets.covariance @ jacobian.T)
    assert derived.sources == budgets.sources


def test_json_is_plain_and_finite() -> None:
    sources = (ErrorSource("a", 0.5, "kg"), PAIR, ErrorSource("b", 2.0, degrees_of_freedom=3))
    table = np.array([[1.0, 2.0, 3.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    budgets = Budgets(("q", "r"), np.array([1.0, 2.0]), ("m", "s"), sources, table)
    found = json.loads(json.dumps(budgets.to_json(), allow_nan=False))
    assert found["names"] == ["q", "r"]
    q, r = found["quantities"]["q"], found["quantities"]["r"]
    assert [row["source"] for row in q["budget"]] == ["pair", "b", "a"]
    assert q["budget"][0]["members"][1] == {
        "source": "y",
        "unit": "V",
        "u": 1.0,
        "sensitivity": 3.0,
        "contribution": 3.0,
    }
    assert q["budget"][0]["correlation"] == [[1.0, 0.75], [0.75, 1.0]]
    assert (r["nu_eff"], r["u"], r["budget"][0]["nu"]) == (None, 0.5, None)
    assert r["k"] == pytest.approx(1.96, abs=1e-3)
    assert r["U95"] == pytest.approx(0.5 * r["k"])
    assert r["interval95"] == pytest.approx([2 - r["U95"], 2 + r["U95"]])
    assert np.array(found["covariance"]) == pytest.approx(budgets.covariance)
    assert np.array(found["correlation"]) == pytest.approx(budgets.correlation)


A, B = ErrorSource("a", 1.0), ErrorSource("b", 0.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Budget("q", math.nan, "m", ()),
        lambda: Budget("q", 0.0, "m", (Contribution(A, 1.0), Contribution(A, 2.0))),
        lambda: Budget("q", 0.0, "m", (Contribution(A, math.inf),)),
        lambda: Budget("q", 0.0, "m", (GroupContribution(PAIR, (1.0,)),)),
        lambda: Budgets((), np.zeros(0), (), (A,), np.zeros((0, 1))),
        lambda: Budgets(("q", "q"), np.zeros(2), ("m", "m"), (A,), np.zeros((2, 1))),
        lambda: Budgets(("q",), np.zeros(2), ("m",), (A,), np.zeros((1, 1))),
        lambda: Budgets(("q",), np.zeros(1), ("m",), (A, A), np.zeros((1, 2))),
        lambda: Budgets(("q",), np.zeros(1), ("m",), (PAIR,), np.zeros((1, 1))),
        lambda: Budgets(("q",), np.zeros(1), ("m",), (A,), np.full((1, 1), math.nan)),
        lambda: Budgets(("q",), np.full(1, math.inf), ("m",), (A,), np.zeros((1, 1))),
        lambda: Budgets.of_contributions(["q"], [0.0], ["m"], [B], [[1.0]]),
        lambda: Budgets.of_contributions(["q"], [0.0], ["m"], [A], [[1.0, 2.0]]),
        lambda: Budgets(("q",), np.zeros(1), ("m",), (A,), np.ones((1, 1))).derived(["r"], [0.0], ["m"], [[1.0, 1.0]]),
        lambda: budget_of([(1.0, 1.0, 1.0)]).interval(1.0),
    ],
)
def test_refused(make: Any) -> None:
    with pytest.raises(BadInput):
        make()


def test_unknown_quantity() -> None:
    with pytest.raises(KeyError, match="there are q"):
        Budgets(("q",), np.zeros(1), ("m",), (A,), np.ones((1, 1)))["r"]
