"""One planned experiment: its settings, its duration and its expected estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate import Estimate
from identification.joint.combine import reduced
from identification.joint.weighting import weighted
from identification.methods import Method, given_by

RESERVE = 1.2
"""Factor on the bound in a plan: estimators only approach the bound, and the rig differs from its nominal values."""


@dataclass(frozen=True)
class Experiment:
    """A test with its settings and its expected estimate.

    Attributes:
        test: name of the test, as in the logs.
        method: estimator of the test.
        settings: settings of the test, name with unit → value.
        record_s: length of the recording, s.
        expected: names, nominal values, own covariance by the Fisher information, and shared errors.
        largest_m: largest expected displacement of the disk, m.
        remarks: assumptions, as sentences.
    """

    test: str
    method: Method
    settings: Mapping[str, float]
    record_s: float
    expected: Estimate
    largest_m: float = 0.0
    remarks: tuple[str, ...] = ()

    def relative_std(self, name: str, runs: int = 1) -> float:
        """Return the relative standard deviation of a parameter after several runs; errors of gain and clock remain."""
        return float(np.hypot(self.noise(name) / np.sqrt(runs), self.floor(name)))

    def noise(self, name: str) -> float:
        """Return the relative standard deviation of a parameter by noise in one run, times RESERVE."""
        i = self.expected.names.index(name)
        return RESERVE * float(np.sqrt(self.expected.covariance[i, i]) / abs(self.expected.values[i]))

    def floor(self, name: str) -> float:
        """Return the relative standard deviation that remains after any number of runs, by errors of gain and clock."""
        i = self.expected.names.index(name)
        return float(
            np.sqrt(sum(float(v[i]) ** 2 for v in self.expected.shared.values())) / abs(self.expected.values[i])
        )


def limited(experiment: Experiment) -> Experiment | None:
    """Return the experiment with only the parameters in its test's row; None if it has none of them."""
    names = [name for name in experiment.expected.names if name in given_by([experiment.test])]
    return replace(experiment, expected=reduced(experiment.expected, names)) if names else None


def together(experiments: list[tuple[Experiment, int]]) -> dict[str, float]:
    """Return the relative standard deviations by parameter after several experiments.

    Args:
        experiments: (experiment, number of runs).
    """
    estimates = [replace(e.expected, covariance=RESERVE**2 / n * e.expected.covariance) for e, n in experiments]
    found = weighted(estimates)
    std = np.sqrt(np.diag(found.covariance))
    return {n: float(s / abs(v)) for n, s, v in zip(found.names, std, found.values, strict=True)}
