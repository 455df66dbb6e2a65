"""Budgets and Monte Carlo results print as a table and become a data frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uncertainty import Budgets, ErrorSource, Group, check_linear, monte_carlo

GROUP = Group("scale", ("a", "b"), ("V", "V"), np.diag([4.0, 9.0]))
SOURCES = (ErrorSource("noise", 0.1, "m", "A", degrees_of_freedom=9), GROUP)
FOUND = Budgets(("y", "z"), np.array([2.0, 3.0]), ("m", ""), SOURCES, np.array([[3.0, 1, 0], [1.0, 0, 1]]))


def test_budgets_have_a_row_for_each_quantity() -> None:
    frame = FOUND.to_dataframe()
    assert frame["name"].tolist() == ["y", "z"]
    assert frame["std"].tolist() == [FOUND["y"].std, FOUND["z"].std]
    assert frame["high_95"].tolist() == [FOUND["y"].interval()[1], FOUND["z"].interval()[1]]


def test_a_budget_has_a_row_for_each_source_the_largest_first() -> None:
    frame = FOUND["y"].to_dataframe()
    assert frame["source"].tolist() == ["scale", "noise"]
    assert frame["contribution"].tolist() == [FOUND["y"].contributions[1].std, FOUND["y"].contributions[0].std]
    assert frame["sensitivity"].isna().tolist() == [True, False]
    assert str(FOUND["y"]).startswith("Budget: y = 2 ± 3.96 m (95 %, k = 1.96)\n")
    assert str(FOUND["z"]).startswith("Budget: z = 3 ± 5.88 (95 %, k = 1.96)\n")


def test_a_monte_carlo_and_its_check_show_what_limits_them() -> None:
    source = ErrorSource("noise", 0.1, "m")
    found = monte_carlo(lambda errors: errors, (source,), seed=1, names=("y",))
    assert found.to_dataframe()["symmetric_low"].tolist() == [found["y"].symmetric[0]]
    assert str(replace(found, stabilised=False)).endswith("too few for 2 stable digits of the standard deviations")
    check = check_linear(Budgets(("y",), np.zeros(1), ("m",), (source,), np.ones((1, 1)))["y"], found)
    assert check.to_dataframe()["difference"].tolist() == [check.low, check.high]
    assert str(check).startswith(f"LinearCheck: {check.verdict} (tolerance 0.005, ")
