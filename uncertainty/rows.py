"""A budget as the rows of a table: one row per source, largest contribution first."""

from __future__ import annotations

from dataclasses import dataclass

from uncertainty.budget import REPORT_LEVEL, AnyContribution, Budget, Contribution, finite


@dataclass(frozen=True)
class BudgetRow:
    """One source in the budget of one quantity.

    Attributes:
        source: name of the source.
        kind: "A" or "B".
        distribution: distribution of the source.
        u: standard uncertainty, in `unit`.
        unit: unit of the source. A group of correlated sources has the unit of the quantity.
        sensitivity: derivative of the quantity by the source; 1 for a group.
        contribution: sensitivity × u with its sign, in the quantity's unit.
        share: share of the quantity's variance.
        degrees_of_freedom: degrees of freedom of the source; infinite if its standard uncertainty is taken as exact.
    """

    source: str
    kind: str
    distribution: str
    u: float
    unit: str
    sensitivity: float
    contribution: float
    share: float
    degrees_of_freedom: float

    def to_json(self) -> dict[str, object]:
        """Return plain finite values; None stands for infinite degrees of freedom."""
        return {
            "source": self.source,
            "type": self.kind,
            "distribution": self.distribution,
            "u": self.u,
            "unit": self.unit,
            "sensitivity": self.sensitivity,
            "contribution": self.contribution,
            "share": self.share,
            "nu": finite(self.degrees_of_freedom),
        }


def budget_rows(budget: Budget, least_share: float = 0.0) -> list[BudgetRow]:
    """Return the rows of a budget, largest contribution first, without sources that contribute nothing.

    Args:
        budget: budget of one quantity.
        least_share: smallest share of the variance that has a row.
    """
    shares = budget.shares
    ranked = sorted(budget.contributions, key=lambda c: -c.std)
    return [_row(c, budget.unit, shares[c.name]) for c in ranked if c.std > 0 and shares[c.name] >= least_share]


def budget_json(budget: Budget, level: float = REPORT_LEVEL) -> dict[str, object]:
    """Return a budget with its rows as plain finite values, expanded uncertainty and interval at 95 % and at the level.

    Raises:
        BadInput: the level is not between 0 and 1.
    """
    return {
        "value": float(budget.value),
        "unit": budget.unit,
        "u": budget.std,
        "nu_eff": finite(budget.degrees_of_freedom),
        "U95": budget.expanded(),
        "interval95": list(budget.interval()),
        "level": level,
        "k": budget.coverage_factor(level),
        "U": budget.expanded(level),
        "interval": list(budget.interval(level)),
        "budget": [row.to_json() for row in budget_rows(budget)],
    }


def _row(contribution: AnyContribution, unit: str, share: float) -> BudgetRow:
    source = contribution.source
    if isinstance(contribution, Contribution):
        parts = contribution.source.std, contribution.source.unit, contribution.sensitivity, contribution.signed
    else:
        parts = contribution.std, unit, 1.0, contribution.std
    u, own_unit, sensitivity, signed = parts
    return BudgetRow(
        contribution.name,
        source.kind,
        source.distribution,
        u,
        own_unit,
        sensitivity,
        signed,
        share,
        source.degrees_of_freedom,
    )
