"""Uncertainty budgets as text for the report's page."""

from __future__ import annotations

import math
from dataclasses import dataclass

from analysis.rounding import plain, with_std
from rig_configs.shared_errors import STANDARD
from uncertainty import Budget, Budgets
from uncertainty.rows import BudgetRow, budget_rows

_MIN_SHARE = 1e-3  # least share of a variance with a row of its own
_UNITS = {"1": "", "deg": "°"}


@dataclass(frozen=True)
class SourceRow:
    """One source of a budget, formatted."""

    source: str
    kind: str
    distribution: str
    degrees: str
    u: str
    contribution: str
    share: str


@dataclass(frozen=True)
class BudgetTable:
    """Formatted budget of one quantity; `rest` names the sources that are too small for a row, "" without any."""

    name: str
    value: str
    expanded: str
    factor: str
    degrees: str
    rows: list[SourceRow]
    rest: str
    rest_share: str


def budget_tables(budgets: Budgets | None) -> list[BudgetTable]:
    """Return one table per quantity; an empty list without budgets."""
    return [] if budgets is None else [_table(each) for each in budgets.budgets]


def _table(budget: Budget) -> BudgetTable:
    unit = _UNITS.get(budget.unit, budget.unit)
    shown, every = budget_rows(budget, _MIN_SHARE), budget_rows(budget)
    more, left = len(every) - len(shown), sum(row.share for row in every[len(shown) :])
    tail = f" {unit}" if unit not in ("", "°") else unit
    return BudgetTable(
        budget.name,
        with_std(float(budget.value), budget.std, unit),
        f"{plain(budget.expanded(), 2)}{tail}",
        f"{budget.coverage_factor():.3f}",
        _degrees(budget.degrees_of_freedom),
        [_row(row, tail) for row in shown],
        f"{more} more" if more else "",
        _share(left),
    )


def _row(row: BudgetRow, tail: str) -> SourceRow:
    unit = _UNITS.get(row.unit, row.unit)
    size = "–" if row.unit == STANDARD else f"{plain(row.u, 3)} {unit}".rstrip()
    return SourceRow(
        row.source,
        row.kind,
        row.distribution,
        _degrees(row.degrees_of_freedom),
        size,
        f"{plain(row.contribution, 2)}{tail}",
        _share(row.share),
    )


def _degrees(number: float) -> str:
    return "∞" if math.isinf(number) else plain(number, 3)


def _share(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= _MIN_SHARE else "< 0.1 %"
