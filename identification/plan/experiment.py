"""One planned experiment: what to do, how long it takes, and what it would tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate import Estimate
from identification.joint.combine import reduced
from identification.joint.weighting import weighted
from identification.methods import Method, given_by

RESERVE = 1.2
"""A plan counts on so many times the bound: estimators come close to it, and the rig is not quite as believed."""


@dataclass(frozen=True)
class Experiment:
    """A test with its settings and the estimate to expect of it.

    Attributes:
        test: as `rig test` and the logs call it.
        method: the estimator that it is made for.
        settings: what to do, name with unit → value.
        record_s: length of the recording.
        expected: names, values as they are believed, own covariance by the Fisher information, shared errors.
        largest_m: largest displacement to expect of the disk, m.
        remarks: what a reader must know.
    """

    test: str
    method: Method
    settings: Mapping[str, float]
    record_s: float
    expected: Estimate
    largest_m: float = 0.0
    remarks: tuple[str, ...] = ()

    def relative_std(self, name: str, runs: int = 1) -> float:
        """Of one parameter after a number of runs: own errors average out, gains and clocks do not."""
        return float(np.hypot(self.noise(name) / np.sqrt(runs), self.floor(name)))

    def noise(self, name: str) -> float:
        """What noise leaves of one run, relative, with the reserve."""
        i = self.expected.names.index(name)
        return RESERVE * float(np.sqrt(self.expected.covariance[i, i]) / abs(self.expected.values[i]))

    def floor(self, name: str) -> float:
        """What is left after any number of runs: gains and clocks, relative."""
        i = self.expected.names.index(name)
        return float(
            np.sqrt(sum(float(v[i]) ** 2 for v in self.expected.shared.values())) / abs(self.expected.values[i])
        )


def limited(experiment: Experiment) -> Experiment | None:
    """An experiment with what its test's row gives alone; None where that is nothing."""
    names = [name for name in experiment.expected.names if name in given_by([experiment.test])]
    return replace(experiment, expected=reduced(experiment.expected, names)) if names else None


def together(experiments: list[tuple[Experiment, int]]) -> dict[str, float]:
    """Relative standard deviations after all experiments, each so many times."""
    estimates = [replace(e.expected, covariance=RESERVE**2 / n * e.expected.covariance) for e, n in experiments]
    found = weighted(estimates)
    std = np.sqrt(np.diag(found.covariance))
    return {n: float(s / abs(v)) for n, s, v in zip(found.names, std, found.values, strict=True)}
