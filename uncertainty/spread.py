"""Joint distribution of quantities from trials: means, covariance and coverage intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from uncertainty.budget import finite
from uncertainty.coverage import Interval, end_errors, shortest_interval, symmetric_interval
from uncertainty.errors import BadInput
from uncertainty.group import correlation_of

_SINGULAR = 1e-10
"""Ratio of smallest to largest eigenvalue of a correlation matrix below which the smallest is mere rounding."""


@dataclass(frozen=True)
class Spread:
    """Distribution of one quantity.

    Attributes:
        name: name of the quantity.
        mean: mean value. This and all following attributes are in the quantity's unit.
        std: standard deviation.
        symmetric: probabilistically symmetric coverage interval.
        shortest: shortest coverage interval.
        end_errors: numerical errors of the symmetric interval's ends, two standard deviations each; infinite if the
            trials are too few for an estimate.
    """

    name: str
    mean: float
    std: float
    symmetric: Interval
    shortest: Interval
    end_errors: Interval

    def to_json(self) -> dict[str, object]:
        """Return plain finite values; None stands for an infinite numerical error."""
        return {
            "name": self.name,
            "mean": self.mean,
            "std": self.std,
            "symmetric": list(self.symmetric),
            "shortest": list(self.shortest),
            "end_errors": [finite(e) for e in self.end_errors],
        }


@dataclass(frozen=True, eq=False)
class MonteCarlo(Tabular):
    """Joint distribution of the quantities.

    Attributes:
        quantities: distribution of each quantity.
        covariance: shape (quantities, quantities).
        level: coverage probability of the intervals.
        trials: number of trials.
        stabilised: whether at least ten batches of trials showed that the results are stable: mean, standard deviation
            and interval ends to `digits` significant digits of the standard deviation or to the rounding of the values,
            and the largest eigenvalue of the correlation matrix to `digits` significant digits of itself.
        digits: requested number of significant digits.
        ellipsoid_factor: k of the ellipsoid (y − ȳ)ᵀ V⁻¹ (y − ȳ) ≤ k² that contains the share `level` of the trials,
            where V is the covariance (JCGM 102, 7.7.2); None if V is singular.
    """

    quantities: tuple[Spread, ...]
    covariance: NDArray[np.float64]
    level: float
    trials: int
    stabilised: bool
    digits: int
    ellipsoid_factor: float | None = None

    def __getitem__(self, name: str) -> Spread:
        """Return the distribution of one quantity.

        Raises:
            KeyError: no quantity has this name.
        """
        for spread in self.quantities:
            if spread.name == name:
                return spread
        raise KeyError(f"no quantity {name!r}; there are {', '.join(q.name for q in self.quantities)}")

    @property
    def heading(self) -> str:
        """Number of trials and level."""
        return f"MonteCarlo: {number_of(self.trials, 'trial')}, intervals of {100 * self.level:g} %"

    @property
    def remarks(self) -> Sequence[str]:
        """Whether more trials are needed."""
        unstable = f"the trials are too few for {number_of(self.digits, 'stable digit')} of the standard deviations"
        return [] if self.stabilised else [unstable]

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity."""
        each = self.quantities
        ends = (("low", 0), ("high", 1))
        return {
            "name": [q.name for q in each],
            "mean": [q.mean for q in each],
            "std": [q.std for q in each],
            **{f"symmetric_{end}": [q.symmetric[i] for q in each] for end, i in ends},
            **{f"shortest_{end}": [q.shortest[i] for q in each] for end, i in ends},
        }

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix, shape (quantities, quantities); off-diagonal 0 for a constant quantity."""
        return correlation_of(self.covariance)

    def to_json(self) -> dict[str, object]:
        """Return plain finite values."""
        return {
            "quantities": {q.name: q.to_json() for q in self.quantities},
            "covariance": self.covariance.tolist(),
            "correlation": self.correlation.tolist(),
            "level": self.level,
            "trials": self.trials,
            "stabilised": self.stabilised,
            "digits": self.digits,
            "ellipsoid_factor": self.ellipsoid_factor,
        }


def quantity_names(names: Sequence[str] | None, quantities: int) -> tuple[str, ...]:
    """Return the names of the quantities; their numbers from 0 if `names` is None.

    Raises:
        BadInput: the number of names differs from that of the quantities, or the names are not unique.
    """
    given = tuple(str(i) for i in range(quantities)) if names is None else tuple(names)
    if len(given) != quantities or len(set(given)) != quantities:
        raise BadInput(
            f"the model has {number_of(quantities, 'quantity', 'quantities')}; the names are {given}; they "
            f"must be as many and unique"
        )
    return given


def summary(
    batches: Sequence[NDArray[np.float64]], names: Sequence[str], level: float, stabilised: bool, digits: int
) -> MonteCarlo:
    """Summarise all trials.

    Args:
        batches: values, each of shape (trials, quantities).
        names: names of the quantities.
        level: coverage probability of the intervals.
        stabilised: as in the result.
        digits: as in the result.

    Raises:
        BadInput: the trials are too few for the level.
    Source: JCGM 101, 7.6 and 7.7; JCGM 102, 7.6.
    """
    width = batches[0].shape[1]
    origin = batches[0][0]  # a constant quantity is then exactly 0
    trials = sum(len(b) for b in batches)
    mean = np.sum([np.sum(b - origin, axis=0) for b in batches], axis=0) / trials
    covariance = np.zeros((width, width))
    for values in batches:
        scatter = values - origin - mean
        covariance += scatter.T @ scatter / (trials - 1)
    spreads: list[Spread] = []
    for i, name in enumerate(names):
        ordered = np.sort(np.concatenate([b[:, i] for b in batches]))
        intervals = [f(ordered, level) for f in (symmetric_interval, shortest_interval, end_errors)]
        spreads.append(Spread(name, float(origin[i] + mean[i]), math.sqrt(float(covariance[i, i])), *intervals))
    factor = _ellipsoid_factor(batches, origin + mean, covariance, level)
    return MonteCarlo(tuple(spreads), covariance, level, trials, stabilised, digits, factor)


def _ellipsoid_factor(
    batches: Sequence[NDArray[np.float64]], mean: NDArray[np.float64], covariance: NDArray[np.float64], level: float
) -> float | None:
    """Return k of the ellipsoid that contains the share `level` of the trials; None if the covariance is singular.

    Args:
        batches: values, each of shape (trials, quantities).
        mean: shape (quantities,).
        covariance: shape (quantities, quantities).
        level: coverage probability.
    """
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(correlation_of(covariance))
    if bool(np.any(std == 0)) or float(values[0]) < _SINGULAR * float(values[-1]):
        return None
    whitened = vectors / np.sqrt(values) / std[:, None]
    distance = np.concatenate([np.linalg.norm((b - mean) @ whitened, axis=1) for b in batches])
    rank = math.ceil(level * len(distance)) - 1
    return float(np.partition(distance, rank)[rank])
