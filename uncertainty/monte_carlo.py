# pyright: strict
"""Propagation of distributions by a Monte Carlo method, with fixed trials or until the numbers are stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from uncertainty.budget import check_names, finite
from uncertainty.coverage import (
    Interval,
    check_level,
    end_errors,
    numerical_tolerance,
    shortest_interval,
    symmetric_interval,
)
from uncertainty.errors import BadInput, BadModel, TooManyTrials
from uncertainty.group import Input

Model = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Errors of shape (n, columns of the sources) to values of shape (n, quantities)."""
Progress = Callable[[int, int | None], None]
"""Called with the trials done and the trials wanted; None while the number is still open."""
Stable = Literal["symmetric", "shortest"]

BATCH = 10_000
LEAST_BATCHES = 10
"""JCGM 101, 7.9.4 may end after two batches, whose two values leave one degree of freedom for their scatter."""


@dataclass(frozen=True)
class Spread:
    """Distribution of one quantity.

    Attributes:
        name: of the quantity.
        mean: in the quantity's unit, as all that follows.
        std: standard deviation.
        symmetric: probabilistically symmetric coverage interval.
        shortest: shortest coverage interval.
        end_errors: numerical errors of the symmetric interval's ends, two standard deviations each; infinite where
            the trials are too few to see them.
    """

    name: str
    mean: float
    std: float
    symmetric: Interval
    shortest: Interval
    end_errors: Interval

    def to_json(self) -> dict[str, object]:
        """Plain finite values; None stands for an infinite numerical error."""
        return {
            "name": self.name,
            "mean": self.mean,
            "std": self.std,
            "symmetric": list(self.symmetric),
            "shortest": list(self.shortest),
            "end_errors": [finite(e) for e in self.end_errors],
        }


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Joint distribution of the quantities.

    Attributes:
        quantities: distribution of each.
        covariance: shape (quantities, quantities).
        level: coverage probability of the intervals.
        trials: number used.
        stabilised: mean, standard deviation and interval ends were stable to `digits` significant digits of the
            standard deviation, and the largest eigenvalue of the correlation matrix to as many of its own.
        digits: those asked for.
    """

    quantities: tuple[Spread, ...]
    covariance: NDArray[np.float64]
    level: float
    trials: int
    stabilised: bool
    digits: int

    def __getitem__(self, name: str) -> Spread:
        """Distribution of one quantity.

        Raises:
            KeyError: no quantity has this name.
        """
        for spread in self.quantities:
            if spread.name == name:
                return spread
        raise KeyError(f"no quantity {name!r}; there are {', '.join(q.name for q in self.quantities)}")

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix, shape (quantities, quantities); 0 beside the diagonal for a constant quantity."""
        return _correlation(self.covariance)

    def to_json(self) -> dict[str, object]:
        """Plain finite values."""
        return {
            "quantities": {q.name: q.to_json() for q in self.quantities},
            "covariance": self.covariance.tolist(),
            "correlation": self.correlation.tolist(),
            "level": self.level,
            "trials": self.trials,
            "stabilised": self.stabilised,
            "digits": self.digits,
        }


def monte_carlo(
    model: Model,
    sources: Sequence[Input],
    *,
    seed: int,
    trials: int | None = None,
    digits: int = 2,
    level: float = 0.95,
    stable: Stable = "symmetric",
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    most_trials: int = 2_000_000,
    most_bytes: int = 512 * 2**20,
    rows: int = BATCH,
) -> MonteCarlo:
    """The distribution of a model's quantities under the errors of its sources.

    Each source has its own random stream in each batch: the same seed gives the same trials whatever `rows`,
    `trials` or the sources behind it are.

    Args:
        model: errors of shape (n, columns) in the sources' units to values of shape (n, quantities).
        sources: the causes; a group takes as many columns as it has members.
        seed: at least 0.
        trials: how many, at least 2 and enough for the level; None: until stable.
        digits: significant digits of the standard uncertainty that are to be stable.
        level: coverage probability of the intervals.
        stable: which interval's ends are to be stable; the shortest one needs many more trials.
        names: of the quantities; their numbers from 0 where None.
        progress: called after each batch.
        most_trials: where the adaptive procedure ends with `stabilised` False.
        most_bytes: bound on the memory of the values kept, 8 bytes a trial and quantity.
        rows: largest number of trials in one call of the model.

    Raises:
        BadInput: a number or a name is outside its domain.
        BadModel: the model's values have another shape or are not finite.
        TooManyTrials: the values of `trials` trials exceed `most_bytes`.
    Source: JCGM 101, 7.2 … 7.9; JCGM 102, 7.8.
    """
    check_level(level)
    check_names(sources)
    if seed < 0 or digits < 1 or rows < 1 or most_trials < 1 or stable not in get_args(Stable):
        raise BadInput(
            f"seed {seed} (≥ 0), digits {digits} (≥ 1), rows {rows} (≥ 1), most_trials {most_trials} (≥ 1), "
            f"stable {stable!r} ({' or '.join(get_args(Stable))}): one is outside its domain"
        )
    if trials is not None and not 0 < math.floor(level * trials + 0.5) < trials:
        raise BadInput(f"{trials} trials do not reach a coverage probability of {level}")
    size = max(BATCH, math.ceil(100.0 / (1.0 - level)))
    wanted = most_trials if trials is None else trials
    batches: list[NDArray[np.float64]] = []
    watch = _Watch(digits, level, stable)
    done = 0
    while done < wanted:
        count = min(size, wanted - done)
        values = _batch(model, sources, (seed, len(batches)), count, rows)
        room = most_bytes // (8 * values.shape[1])
        if trials is not None and trials > room:
            raise TooManyTrials(f"{trials} trials exceed most_bytes; {room} fit for {values.shape[1]} quantities")
        batches.append(values)
        done += count
        if count == size:
            watch.add(values)
        if progress is not None:
            progress(done, trials)
        if trials is None and (watch.settled() or done + size > room):
            break
    return _result(batches, watch, names)


class _Watch:
    """Scatter between whole batches of what is to be stable."""

    def __init__(self, digits: int, level: float, stable: Stable) -> None:
        self.digits, self.level = digits, level
        self.interval = symmetric_interval if stable == "symmetric" else shortest_interval
        self.found: list[NDArray[np.float64]] = []
        self.eigenvalues: list[float] = []

    def add(self, values: NDArray[np.float64]) -> None:
        """One more batch, shape (batch, quantities)."""
        ordered = np.sort(values, axis=0)
        ends = np.array([self.interval(column, self.level) for column in ordered.T])
        centre, std = np.mean(values, axis=0), np.std(values, axis=0, ddof=1)
        self.found.append(np.column_stack([centre, std, ends]))
        self.eigenvalues.append(_largest_eigenvalue(np.cov(values, rowvar=False)))

    def settled(self) -> bool:
        """Twice the scatter of each mean over the batches is within the numerical tolerance."""
        count = len(self.found)
        if count < LEAST_BATCHES:
            return False
        table = np.array(self.found)  # (batches, quantities, mean | std | low | high)
        doubt = 2.0 * np.std(table, axis=0, ddof=1) / math.sqrt(count)
        rounding = 16.0 * np.finfo(np.float64).eps * np.max(np.abs(table), axis=(0, 2))
        between = np.var(table[:, :, 0], axis=0)
        std = np.sqrt(np.mean(table[:, :, 1] ** 2, axis=0) + between)
        tolerance = np.array([numerical_tolerance(float(u), self.digits) for u in std])
        if bool(np.any(doubt > np.maximum(tolerance, rounding)[:, None])):
            return False
        largest = np.array(self.eigenvalues)
        eigenvalue_doubt = 2.0 * float(np.std(largest, ddof=1)) / math.sqrt(count)
        return eigenvalue_doubt <= numerical_tolerance(float(np.mean(largest)), self.digits)


def _batch(
    model: Model, sources: Sequence[Input], stream: tuple[int, int], count: int, rows: int
) -> NDArray[np.float64]:
    """Values of one batch of trials, shape (count, quantities).

    Raises:
        BadModel: the model's values have another shape or are not finite.
    """
    errors = np.concatenate(
        [np.zeros((count, 0))]
        + [
            source.draw(np.random.default_rng([*stream, i]), count).reshape(count, source.width)
            for i, source in enumerate(sources)
        ],
        axis=1,
    )
    parts: list[NDArray[np.float64]] = []
    for start in range(0, count, rows):
        block = errors[start : start + rows]
        values = np.asarray(model(block), dtype=np.float64)
        if values.ndim != 2 or len(values) != len(block) or values.shape[1] == 0:
            raise BadModel(
                f"the model returned shape {values.shape} for errors of shape {block.shape}; "
                f"({len(block)}, quantities) is needed"
            )
        bad = ~np.all(np.isfinite(values), axis=1)
        if bool(np.any(bad)):
            first = int(np.argmax(bad))
            raise BadModel(
                f"the model returned values that are not finite in {int(np.sum(bad))} of {len(block)} trials, first "
                f"for the errors {block[first].tolist()}"
            )
        parts.append(values)
    return np.concatenate(parts)


def _result(batches: list[NDArray[np.float64]], watch: _Watch, names: Sequence[str] | None) -> MonteCarlo:
    """Summary of all trials.

    Raises:
        BadInput: the number of names is not that of the quantities, or they are not unique.
    """
    width = batches[0].shape[1]
    given = [str(i) for i in range(width)] if names is None else list(names)
    if len(given) != width or len(set(given)) != width:
        raise BadInput(f"the model has {width} quantities; the names are {given}; they must be as many and unique")
    trials = sum(len(b) for b in batches)
    mean = np.sum([np.sum(b, axis=0) for b in batches], axis=0) / trials
    covariance = np.sum([(b - mean).T @ (b - mean) for b in batches], axis=0) / (trials - 1)
    spreads: list[Spread] = []
    for i, name in enumerate(given):
        ordered = np.sort(np.concatenate([b[:, i] for b in batches]))
        spreads.append(
            Spread(
                name,
                float(mean[i]),
                math.sqrt(float(covariance[i, i])),
                symmetric_interval(ordered, watch.level),
                shortest_interval(ordered, watch.level),
                end_errors(ordered, watch.level),
            )
        )
    return MonteCarlo(tuple(spreads), covariance, watch.level, trials, watch.settled(), watch.digits)


def _correlation(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlation matrix of a covariance matrix; 0 beside the diagonal for a constant."""
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    matrix = np.clip(covariance / scale[:, None] / scale[None, :], -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    return matrix


def _largest_eigenvalue(covariance: NDArray[np.float64]) -> float:
    """Largest eigenvalue of the correlation matrix."""
    return float(np.linalg.eigvalsh(_correlation(np.atleast_2d(covariance)))[-1])
