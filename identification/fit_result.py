"""What every fit of a test has: values with covariance and intervals, the model, and what limits their use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular


class FitResult(Tabular):
    """Values of a fit, as a table.

    Attributes:
        values: name → value.
        covariance: in the order of the values, shape (n, n).
        intervals: name → 95 % interval.
        chi2_per_dof: χ² of the residuals per degree of freedom.
        model: name of the fitted model.
        warnings: findings that limit the use of the values.
    """

    values: dict[str, float]
    covariance: Array
    intervals: dict[str, tuple[float, float]]
    chi2_per_dof: float
    model: str
    warnings: list[str]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name, without the errors of gains and clocks."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def heading(self) -> str:
        """Kind of the fit, its model and its residuals."""
        return f"{type(self).__name__}: {self.model}, χ²/dof {self.chi2_per_dof:.3g}"

    @property
    def remarks(self) -> Sequence[str]:
        """The warnings."""
        return self.warnings

    def columns(self) -> Mapping[str, Column]:
        """Return each value with its standard deviation and its 95 % interval."""
        low, high = zip(*(self.intervals[name] for name in self.values), strict=True)
        return {
            "name": list(self.values),
            "value": list(self.values.values()),
            "std": list(self.std.values()),
            "low_95": low,
            "high_95": high,
        }
