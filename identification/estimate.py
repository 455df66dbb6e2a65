"""One test's answer in the form the joint estimate takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rig_configs.known import LABEL, KnownSource

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
        by_number: number of the rig file that is taken as known → derivative of the values by it, shape (n,).
        method: for the provenance.
        with_terms: of the suspension's terms that the test shows → covariance of the values with it, shape (n,).
    """

    test: str
    source: str
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    shared: Mapping[str, np.ndarray] = field(default_factory=dict)
    method: str = ""
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict)
    with_terms: Mapping[str, np.ndarray] = field(default_factory=dict)

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

    def with_sources(self, sources: Iterable[KnownSource]) -> Estimate:
        """The same with the errors of what is taken as known among its shared ones, in place of any that it had."""
        shared = {label: v for label, v in self.shared.items() if not label.startswith(f"{LABEL} ")}
        for source in sources:
            parts = [self.by_number[name] * step for name, step in source.effects.items() if name in self.by_number]
            if parts:
                shared[source.label] = np.sum(parts, axis=0)
        return replace(self, shared=shared)

    @property
    def std(self) -> dict[str, float]:
        """Total standard deviations by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.total_covariance)).tolist(), strict=True))

    def value(self, name: str) -> float:
        """One value by name."""
        return float(self.values[self.names.index(name)])
