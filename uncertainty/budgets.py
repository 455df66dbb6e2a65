"""Uncertainty budgets of several quantities with common sources: single budgets, joint covariance and correlation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from uncertainty.budget import AnyContribution, Budget, Contribution, GroupContribution, check_names
from uncertainty.errors import BadInput
from uncertainty.group import Input
from uncertainty.source import ErrorSource


@dataclass(frozen=True, eq=False)
class Budgets(Tabular):
    """Budgets of several quantities by the law of propagation of uncertainty (JCGM 102, 6.2).

    The columns are the sources in their order. A group of n correlated sources occupies n columns.

    Attributes:
        names: unique names of the quantities.
        values: estimates, shape (quantities,).
        units: units of the quantities.
        sources: sources of error, with unique names.
        sensitivities: C, shape (quantities, columns), in the quantity's unit over the source's.

    Raises:
        BadInput: shapes do not match, a name occurs twice, or a number is not finite.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    units: tuple[str, ...]
    sources: tuple[Input, ...]
    sensitivities: NDArray[np.float64]

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        table = np.array(self.sensitivities, dtype=np.float64)
        n, columns = len(self.names), sum(s.width for s in self.sources)
        if n == 0 or len(set(self.names)) != n or len(self.units) != n:
            raise BadInput(
                f"{number_of(n, 'quantity', 'quantities')} (they need unique names) and {len(self.units)} units "
                f"do not match"
            )
        if values.shape != (n,) or table.shape != (n, columns):
            raise BadInput(
                f"{number_of(n, 'quantity', 'quantities')} and {number_of(columns, 'column')} of sources need "
                f"values of shape {(n,)} and sensitivities of "
                f"shape {(n, columns)}; their shapes are {values.shape} and {table.shape}"
            )
        if not (bool(np.all(np.isfinite(values))) and bool(np.all(np.isfinite(table)))):
            raise BadInput("values and sensitivities must be finite")
        check_names(self.sources)
        for field, array in (("values", values), ("sensitivities", table)):
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        for field in ("names", "units", "sources"):
            object.__setattr__(self, field, tuple(getattr(self, field)))

    @classmethod
    def of_contributions(
        cls,
        names: Sequence[str],
        values: ArrayLike,
        units: Sequence[str],
        sources: Sequence[Input],
        contributions: ArrayLike,
    ) -> Budgets:
        """Create budgets from signed contributions c u instead of sensitivities.

        Args:
            names: names of the quantities.
            values: estimates, shape (quantities,).
            units: units of the quantities.
            sources: sources of error.
            contributions: shape (quantities, columns), in the quantities' units.

        Raises:
            BadInput: as for the class, or a source of standard uncertainty 0 has a contribution.
        """
        table = np.asarray(contributions, dtype=np.float64)
        std = np.concatenate([np.atleast_1d(s.std) for s in sources]) if sources else np.zeros(0)
        if table.shape != (len(names), len(std)):
            raise BadInput(f"contributions have shape {table.shape}; {(len(names), len(std))} is needed")
        if bool(np.any(table[:, std == 0])):
            raise BadInput("a source of standard uncertainty 0 has a contribution other than 0")
        sensitivities = np.divide(table, std, out=np.zeros_like(table), where=np.broadcast_to(std > 0, table.shape))
        return cls(tuple(names), np.asarray(values), tuple(units), tuple(sources), sensitivities)

    def __getitem__(self, name: str) -> Budget:
        """Return the budget of one quantity.

        Raises:
            KeyError: no quantity has this name.
        """
        if name not in self.names:
            raise KeyError(f"no quantity {name!r}; there are {', '.join(self.names)}")
        i = self.names.index(name)
        contributions: list[AnyContribution] = []
        column = 0
        for source in self.sources:
            row = tuple(float(c) for c in self.sensitivities[i, column : column + source.width])
            column += source.width
            contributions.append(
                Contribution(source, row[0]) if isinstance(source, ErrorSource) else GroupContribution(source, row)
            )
        return Budget(name, float(self.values[i]), self.units[i], tuple(contributions))

    @property
    def budgets(self) -> tuple[Budget, ...]:
        """Budgets in the order of the quantities."""
        return tuple(self[name] for name in self.names)

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity: value, standard uncertainty and 95 % interval."""
        each = self.budgets
        low, high = zip(*(b.interval() for b in each), strict=True)
        return {
            "name": self.names,
            "value": self.values,
            "std": [b.std for b in each],
            "low_95": low,
            "high_95": high,
            "unit": self.units,
            "degrees_of_freedom": [b.degrees_of_freedom for b in each],
        }

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Joint covariance C V Cᵀ, shape (quantities, quantities), where V is the covariance of the sources."""
        factor = self._factor()
        return factor @ factor.T

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix, shape (quantities, quantities); off-diagonal 0 for a quantity without error."""
        factor = self._factor()
        length = np.linalg.norm(factor, axis=1)
        unit = factor / np.where(length > 0, length, 1.0)[:, None]
        matrix = np.clip(unit @ unit.T, -1.0, 1.0)
        np.fill_diagonal(matrix, 1.0)
        return matrix

    def derived(self, names: Sequence[str], values: ArrayLike, units: Sequence[str], jacobian: ArrayLike) -> Budgets:
        """Return budgets of quantities that are computed from these, with the same sources.

        Args:
            names: names of the new quantities.
            values: estimates of the new quantities, shape (new,).
            units: units of the new quantities.
            jacobian: derivatives of the new quantities by these, shape (new, quantities).

        Raises:
            BadInput: shapes do not match, a name occurs twice, or a number is not finite.
        Source: chain rule, JCGM 102, 6.2.1.
        """
        table = np.asarray(jacobian, dtype=np.float64)
        if table.shape != (len(names), len(self.names)):
            raise BadInput(f"the jacobian has shape {table.shape}; {(len(names), len(self.names))} is needed")
        return Budgets(tuple(names), np.asarray(values), tuple(units), self.sources, table @ self.sensitivities)

    def to_json(self) -> dict[str, object]:
        """Return plain finite values: quantities by name, their order, covariance and correlation in that order."""
        return {
            "names": list(self.names),
            "quantities": {b.name: b.to_json() for b in self.budgets},
            "covariance": self.covariance.tolist(),
            "correlation": self.correlation.tolist(),
        }

    def _factor(self) -> NDArray[np.float64]:
        """Return a factor of the joint covariance, shape (quantities, columns)."""
        factor = np.zeros_like(self.sensitivities)
        column = 0
        for source in self.sources:
            here = slice(column, column + source.width)
            factor[:, here] = self.sensitivities[:, here] @ source.factor
            column += source.width
        return factor
