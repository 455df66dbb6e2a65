"""Result of one test in the form that the joint estimate uses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from identification.sources import Sources, joined, log_names
from rig_configs.error_label import ErrorLabel
from rig_configs.known import KnownSource


@dataclass(frozen=True)
class Estimate:
    """Values that one test determines.

    Attributes:
        test, sources: test name, and log of the run; several logs if they were fitted together.
        names: names of the n parameters as in the parameters file.
        values: shape (n,), SI.
        covariance: covariance of the test's own errors, shape (n, n).
        shared: errors that several tests have in common, such as a laser's gain or a device's clock rate: label →
            shift of the values for one standard deviation of the error, shape (n,).
        by_number: number of the rig file that is taken as known → derivative of the values by it, shape (n,).
        method: name of the method, for the provenance.
        with_terms: term of the suspension that the test determines → its covariance with the values, shape (n,).
    """

    test: str
    sources: Sources
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    shared: Mapping[ErrorLabel, np.ndarray] = field(default_factory=dict[ErrorLabel, np.ndarray])
    method: str = ""
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    with_terms: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])

    @property
    def source(self) -> str:
        """Paths of the logs as one text."""
        return joined(self.sources)

    @property
    def called(self) -> str:
        """Test name and file names of the logs, for messages."""
        return f"{self.test} ({log_names(self.sources)})"

    @property
    def total_covariance(self) -> np.ndarray:
        """Own and shared errors together, shape (n, n)."""
        return self.covariance + sum((np.outer(v, v) for v in self.shared.values()), np.zeros_like(self.covariance))

    @property
    def weighing_covariance(self) -> np.ndarray:
        """Covariance for the test's weight: own and shared errors without friction, which all tests find."""
        found = self.covariance.copy()
        for label, shift in self.shared.items():
            if label.kind != "friction":
                found = found + np.outer(shift, shift)
        return found

    def with_sources(self, sources: Iterable[KnownSource]) -> Estimate:
        """Return the estimate with the errors of the known numbers as shared errors. Former ones are replaced."""
        shared = {label: v for label, v in self.shared.items() if label.kind != "known"}
        for source in sources:
            parts = [self.by_number[name] * step for name, step in source.effects.items() if name in self.by_number]
            if parts:
                shared[source.label] = np.sum(parts, axis=0)
        return replace(self, shared=shared)

    @property
    def std(self) -> dict[str, float]:
        """Total standard deviation of each value, by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.total_covariance)).tolist(), strict=True))

    def value(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.values[self.names.index(name)])
