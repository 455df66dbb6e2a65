"""Uncertainty budget of one quantity: contributions of its sources, combined and expanded uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.tabular import Column, Tabular
from uncertainty.coverage import Interval, coverage_factor
from uncertainty.errors import BadInput
from uncertainty.group import Group, Input, correlation_of
from uncertainty.source import ErrorSource

REPORT_LEVEL = 0.95


@dataclass(frozen=True)
class Contribution:
    """Contribution of one source to a quantity.

    Attributes:
        source: source of error.
        sensitivity: derivative of the quantity by the source, c, in the quantity's unit over the source's.
    """

    source: ErrorSource
    sensitivity: float

    @property
    def name(self) -> str:
        """Name of the source."""
        return self.source.name

    @property
    def signed(self) -> float:
        """Product c u, in the quantity's unit, with the sign of the sensitivity."""
        return self.sensitivity * self.source.std

    @property
    def std(self) -> float:
        """Standard uncertainty |c| u, in the quantity's unit."""
        return abs(self.signed)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the source."""
        return self.source.degrees_of_freedom


@dataclass(frozen=True)
class GroupContribution:
    """Joint contribution of correlated sources to a quantity: one term of the budget.

    Attributes:
        source: group of correlated sources.
        sensitivities: derivatives of the quantity by the members, each in the quantity's unit over the member's.
    """

    source: Group
    sensitivities: tuple[float, ...]

    @property
    def name(self) -> str:
        """Name of the group."""
        return self.source.name

    @property
    def signed(self) -> NDArray[np.float64]:
        """Product c u of each member, shape (members,), in the quantity's unit.

        The members are correlated, so the sum of the squares is not the variance of the group.
        """
        return np.array(self.sensitivities) * self.source.std

    @property
    def std(self) -> float:
        """Standard uncertainty sqrt(cᵀ V c), in the quantity's unit."""
        return math.hypot(*(np.array(self.sensitivities) @ self.source.factor))

    @property
    def degrees_of_freedom(self) -> float:
        """Joint degrees of freedom of the group."""
        return self.source.degrees_of_freedom


AnyContribution = Contribution | GroupContribution


@dataclass(frozen=True)
class Budget(Tabular):
    """Uncertainty budget of one quantity by the law of propagation of uncertainty (JCGM 100, 5.1.2 and 5.2.2).

    Attributes:
        name: name of the quantity.
        value: estimate of the quantity.
        unit: unit of the quantity.
        contributions: one for each source and one for each group of correlated sources, with unique names.

    Raises:
        BadInput: two contributions have the same name, a number is not finite, or a group has the wrong number of
            sensitivities.
    """

    name: str
    value: float
    unit: str
    contributions: tuple[AnyContribution, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "contributions", tuple(self.contributions))
        check_names([c.source for c in self.contributions])
        if not math.isfinite(self.value):
            raise BadInput(f"quantity {self.name!r}: the value is {self.value}; it must be finite")
        for c in self.contributions:
            given = (c.sensitivity,) if isinstance(c, Contribution) else c.sensitivities
            if len(given) != c.source.width or not all(math.isfinite(x) for x in given):
                raise BadInput(
                    f"quantity {self.name!r}, source {c.name!r}: sensitivities are {given}; {c.source.width} finite "
                    "ones are needed"
                )

    @property
    def std(self) -> float:
        """Combined standard uncertainty u_c, in the quantity's unit."""
        return math.hypot(*(c.std for c in self.contributions))

    @property
    def shares(self) -> dict[str, float]:
        """Share of the variance by source or group, sum 1; all shares are 0 if the variance is 0."""
        combined = self.std
        return {c.name: (c.std / combined) ** 2 if combined > 0 else 0.0 for c in self.contributions}

    @property
    def degrees_of_freedom(self) -> float:
        """Effective degrees of freedom by Welch and Satterthwaite; a group counts as one term.

        The value is not rounded. It is infinite if no contribution has finite degrees of freedom.
        Source: JCGM 100, G.4.1: u_c⁴/ν = Σ (c u)⁴/ν_i.
        """
        shares = self.shares
        inverse = math.fsum(shares[c.name] ** 2 / c.degrees_of_freedom for c in self.contributions)
        return 1.0 / inverse if inverse > 0 else math.inf

    def coverage_factor(self, level: float = REPORT_LEVEL) -> float:
        """Return Student's factor k for a coverage probability and the effective degrees of freedom.

        Raises:
            BadInput: the level is not between 0 and 1.
        """
        return coverage_factor(level, self.degrees_of_freedom)

    def expanded(self, level: float = REPORT_LEVEL) -> float:
        """Return the expanded uncertainty U = k u_c, in the quantity's unit.

        Raises:
            BadInput: the level is not between 0 and 1.
        """
        return self.coverage_factor(level) * self.std

    def interval(self, level: float = REPORT_LEVEL) -> Interval:
        """Return the coverage interval value ± U, in the quantity's unit.

        Raises:
            BadInput: the level is not between 0 and 1.
        """
        reach = self.expanded(level)
        return self.value - reach, self.value + reach

    @property
    def ranked(self) -> tuple[AnyContribution, ...]:
        """The contributions, largest first."""
        return tuple(sorted(self.contributions, key=lambda c: -c.std))

    @property
    def heading(self) -> str:
        """Value, expanded uncertainty and coverage factor."""
        reach = f"{self.expanded():.3g} {self.unit}".rstrip()
        return f"Budget: {self.name} = {self.value:.6g} ± {reach} (95 %, k = {self.coverage_factor():.3g})"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each source or group, largest first; a group has no sensitivity of its own."""
        ranked, shares = self.ranked, self.shares
        return {
            "source": [c.name for c in ranked],
            "type": [c.source.kind for c in ranked],
            "contribution": [c.std for c in ranked],
            "share": [shares[c.name] for c in ranked],
            "sensitivity": [c.sensitivity if isinstance(c, Contribution) else math.nan for c in ranked],
            "degrees_of_freedom": [c.degrees_of_freedom for c in ranked],
        }

    def to_json(self) -> dict[str, object]:
        """Return plain finite values at 95 %, largest contribution first; None for infinite degrees of freedom."""
        shares = self.shares
        return {
            "name": self.name,
            "value": float(self.value),
            "unit": self.unit,
            "u": self.std,
            "nu_eff": finite(self.degrees_of_freedom),
            "k": self.coverage_factor(),
            "U95": self.expanded(),
            "interval95": list(self.interval()),
            "budget": [_row(c, shares[c.name]) for c in self.ranked],
        }


def finite(number: float) -> float | None:
    """Return the number, or None if it is not finite, since JSON has no value for it."""
    return float(number) if math.isfinite(number) else None


def check_names(inputs: Sequence[Input]) -> None:
    """Check that the names of sources and groups are unique.

    A source that is given twice would count as two independent ones.

    Raises:
        BadInput: a name occurs more than once.
    """
    names = [i.name for i in inputs]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise BadInput(f"sources need unique names; given more than once: {', '.join(twice)}")


def _row(contribution: AnyContribution, share: float) -> dict[str, object]:
    """Return one row of a budget as JSON values."""
    source = contribution.source
    row: dict[str, object] = {
        "source": contribution.name,
        "type": source.kind,
        "distribution": source.distribution,
        "nu": finite(source.degrees_of_freedom),
        "share": share,
    }
    if isinstance(contribution, Contribution):
        return row | {
            "u": float(contribution.source.std),
            "unit": contribution.source.unit,
            "sensitivity": float(contribution.sensitivity),
            "contribution": float(contribution.signed),
        }
    group = contribution.source
    members = zip(group.members, group.units, group.std, contribution.sensitivities, contribution.signed, strict=True)
    return row | {
        "contribution": contribution.std,
        "correlation": correlation_of(group.covariance).tolist(),
        "members": [
            {"source": name, "unit": unit, "u": float(u), "sensitivity": float(c), "contribution": float(cu)}
            for name, unit, u, c, cu in members
        ],
    }
