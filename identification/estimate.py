"""One test's answer in the form the joint estimate takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

FOUND_TOGETHER = "friction"
"""Begin of the labels of errors in what all tests together have found and each was given."""


@dataclass(frozen=True)
class Estimate:
    """Values one test found.

    Attributes:
        test, source: the run's test name and log.
        names: parameters in their file names, n of them.
        values: shape (n,), SI.
        covariance: this test's own, shape (n, n).
        shared: what every test of the same sensor has in common, one error each: label → the values' shift for one
            standard deviation of it, shape (n,). A laser's gain and a device's clock rate are such.
        method: for the provenance.
    """

    test: str
    source: str
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    shared: Mapping[str, np.ndarray] = field(default_factory=dict)
    method: str = ""

    @property
    def total_covariance(self) -> np.ndarray:
        """Own and shared errors together, shape (n, n)."""
        return self.covariance + sum((np.outer(v, v) for v in self.shared.values()), np.zeros_like(self.covariance))

    @property
    def weighing_covariance(self) -> np.ndarray:
        """What a test weighs by: its own errors and shared ones, but those found from the tests together."""
        found = self.covariance.copy()
        for label, shift in self.shared.items():
            if not label.startswith(FOUND_TOGETHER):
                found = found + np.outer(shift, shift)
        return found

    @property
    def std(self) -> dict[str, float]:
        """Total standard deviations by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.total_covariance)).tolist(), strict=True))

    def value(self, name: str) -> float:
        """One value by name."""
        return float(self.values[self.names.index(name)])
