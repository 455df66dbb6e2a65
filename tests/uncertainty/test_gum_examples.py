"""Worked examples of JCGM 100: the end gauge (H.1), resistance and reactance measured together (H.2)."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from tests.uncertainty.gum_models import GAUGE, OBSERVATIONS, gauge_length, impedance
from uncertainty import Group, coverage_factor, linear_budgets, second_order_variance


def test_end_gauge() -> None:
    budget = linear_budgets(gauge_length, GAUGE, ["length"], ["nm"])["length"]
    assert budget.value == pytest.approx(50_000_838, abs=0.5)
    assert budget.std == pytest.approx(32, abs=0.5)
    assert int(budget.degrees_of_freedom) == 16
    # H.1.6 rounds u to 32 nm and ν to 16 before it expands them to 93 nm
    assert round(coverage_factor(0.99, math.floor(budget.degrees_of_freedom)) * round(budget.std)) == 93
    assert budget.expanded(0.99) == pytest.approx(91.94, abs=0.01)
    signed = {c.name: c.std for c in budget.contributions}
    assert signed["length of the standard"] == pytest.approx(25, abs=0.05)
    assert signed["difference of expansions"] == pytest.approx(2.9, abs=0.05)
    assert signed["difference of temperatures"] == pytest.approx(16.6, abs=0.05)
    assert signed["expansion"] == pytest.approx(0, abs=1e-3)
    of_comparison = math.hypot(*(c.std for c in budget.contributions[1:4]))
    assert of_comparison == pytest.approx(9.7, abs=0.05)


def test_end_gauge_second_order() -> None:
    first = linear_budgets(gauge_length, GAUGE, ["length"], ["nm"])["length"].std
    second = float(second_order_variance(gauge_length, GAUGE)[0])
    assert math.sqrt(second) == pytest.approx(math.hypot(11.7, 1.7), abs=0.15)
    assert math.sqrt(first**2 + second) == pytest.approx(34, abs=0.5)


def test_resistance_and_reactance() -> None:
    group = Group.of_observations("readings", ["V", "I", "phase"], ["V", "A", "rad"], OBSERVATIONS)
    assert group.std == pytest.approx([0.0032, 0.0095e-3, 0.00075], rel=0.02)
    r = group.covariance / np.outer(group.std, group.std)
    assert [r[0, 1], r[0, 2], r[1, 2]] == pytest.approx([-0.36, 0.86, -0.65], abs=0.006)

    budgets = linear_budgets(impedance, [group], ["R", "X", "Z"], ["Ω"] * 3, step=1e-3)
    assert budgets.values == pytest.approx([127.732, 219.847, 254.260], abs=6e-4)
    assert [b.std for b in budgets.budgets] == pytest.approx([0.071, 0.2955, 0.236], abs=6e-4)
    found = budgets.correlation
    assert [found[0, 1], found[0, 2], found[1, 2]] == pytest.approx([-0.588, -0.485, 0.993], abs=6e-4)
    assert [b.degrees_of_freedom for b in budgets.budgets] == pytest.approx([4, 4, 4])
    assert budgets["R"].shares == pytest.approx({"readings": 1.0})


def test_resistance_and_reactance_set_by_set() -> None:
    """Approach 2 of H.2.4: R, X and Z of each set of readings, then their means and covariances."""
    each = impedance(OBSERVATIONS - np.mean(OBSERVATIONS, axis=0))
    group = Group.of_observations("sets", ["R", "X", "Z"], ["Ω"] * 3, each)
    assert np.mean(each, axis=0) == pytest.approx([127.732, 219.847, 254.260], abs=2e-3)
    assert group.std == pytest.approx([0.071, 0.2955, 0.236], abs=6e-4)


def test_example_of_the_theory_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).parents[2] / "docs" / "theory" / "uncertainty.md"
    examples = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(examples) == 1
    exec(compile(examples[0], page.name, "exec"), {})
    printed = capsys.readouterr().out
    assert printed.split()[-1] in {"agree", "differ"}
