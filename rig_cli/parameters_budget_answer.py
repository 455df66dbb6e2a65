"""Budgets of parameters and predicted quantities, selected and put together for `rig parameters budget`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from analysis.budget import PredictedBudgets
    from identification.joint.budget import ParameterBudgets
    from uncertainty import Budgets, LinearCheck, MonteCarlo


@dataclass(frozen=True)
class Selection:
    """Quantities of a budget.

    Attributes:
        parameters: names of the file's parameters.
        points: points of the rig file.
        quantities: single quantities of points; empty: all of each point.
    """

    parameters: tuple[str, ...]
    points: tuple[str, ...]
    quantities: frozenset[str] = frozenset()

    def shows(self, quantity: str) -> bool:
        """Return whether a predicted quantity is requested."""
        return not self.quantities or quantity in self.quantities


@dataclass(frozen=True)
class BudgetAnswer:
    """Budgets of parameters and predictions, with the other results."""

    selection: Selection
    of_parameters: ParameterBudgets
    predicted: PredictedBudgets | None
    exact: Mapping[str, Mapping[str, float]]
    skipped: Mapping[str, str]
    sampled: Sequence[MonteCarlo] = ()
    checks: Mapping[str, Mapping[str, LinearCheck]] = field(default_factory=dict[str, "Mapping[str, LinearCheck]"])

    @property
    def together(self) -> Budgets:
        """Budgets of everything that is shown, on the same sources."""
        from uncertainty import Budgets

        parameters = self.of_parameters.budgets
        names = list(self.selection.parameters)
        at = [parameters.names.index(name) for name in names]
        values, units = [parameters.values[at]], [parameters.units[i] for i in at]
        sources, tables = parameters.sources, [parameters.sensitivities[at]]
        if self.predicted is not None:
            found = self.predicted.budgets
            rows = [i for i, name in enumerate(found.names) if self.selection.shows(name)]
            extra = np.zeros((len(at), found.sensitivities.shape[1] - parameters.sensitivities.shape[1]))
            sources, tables = found.sources, [np.concatenate([tables[0], extra], axis=1), found.sensitivities[rows]]
            values.append(found.values[rows])
            names += [found.names[i] for i in rows]
            units += [found.units[i] for i in rows]
        return Budgets(tuple(names), np.concatenate(values), tuple(units), sources, np.concatenate(tables))
