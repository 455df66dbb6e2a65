"""Propagation of distributions by a Monte Carlo method, with a fixed or an adaptive number of trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of
from uncertainty.budget import check_names
from uncertainty.coverage import IntervalKind, check_level
from uncertainty.errors import BadInput, TooManyTrials
from uncertainty.group import Input
from uncertainty.model import Model, values_of
from uncertainty.spread import MonteCarlo, quantity_names, summary
from uncertainty.stable_numbers import Stability

Progress = Callable[[int, int | None], None]
"""Called with the number of completed trials and the number of requested trials, None if that is not fixed."""

BATCH = 10_000
"""Smallest number of trials in a batch (JCGM 101, 7.9.4)."""


@dataclass(frozen=True, kw_only=True)
class TrialLimits:
    """Limits of a Monte Carlo calculation.

    Attributes:
        digits: number of significant digits of the standard deviation that must be stable.
        interval: kind of interval whose ends must be stable. Ends of the shortest interval need many more trials.
        most_trials: largest number of trials of the adaptive procedure, which then ends with `stabilised` False.
        most_bytes: largest memory for the stored values, 8 bytes per trial and quantity; limits adaptive trials too.
        rows: largest number of trials in one call of the model.
    """

    digits: int = 2
    interval: IntervalKind = "symmetric"
    most_trials: int = 2_000_000
    most_bytes: int = 512 * 2**20
    rows: int = BATCH


_USUAL_LIMITS = TrialLimits()


def monte_carlo(
    model: Model,
    sources: Sequence[Input],
    *,
    seed: int,
    trials: int | None = None,
    level: float = 0.95,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    limits: TrialLimits = _USUAL_LIMITS,
) -> MonteCarlo:
    """Return the joint distribution of a model's quantities for the errors of its sources.

    The errors that a seed gives to a source are independent of `limits`, of `trials` and of the sources after it.

    Args:
        model: maps errors (n, columns) in the sources' units to values (n, quantities). The first call has one row of
            zeros.
        sources: sources of error; a group occupies as many columns as it has members.
        seed: seed of the random numbers, at least 0.
        trials: number of trials; None: batches of 10⁴ or, if that is more, 100/(1 − level) until results are stable.
        level: coverage probability of the intervals.
        names: names of the quantities; None selects their numbers from 0.
        progress: called after each call of the model with trials.
        limits: end of the adaptive procedure, and memory.

    Raises:
        BadInput: a number or a name is outside its domain.
        BadModel: the model's values have another shape or are not finite.
        TooManyTrials: the values of `trials` trials, or of one batch, exceed the memory.
    Source: JCGM 101, 7.2 … 7.9; JCGM 102, 7.

    Example:
        >>> import numpy as np
        >>> from uncertainty import ErrorSource, check_linear, linear_budgets, monte_carlo
        >>> angle = ErrorSource("angle", 0.2, "rad")
        >>> def height(errors):
        ...     return np.cos(0.5 + errors)
        >>> found = monte_carlo(height, [angle], seed=1, trials=20_000, names=["height"])
        >>> [round(end, 2) for end in found["height"].symmetric]
        [0.63, 0.99]
        >>> check_linear(linear_budgets(height, [angle], ["height"], ["m"])["height"], found).verdict
        'differ'
    """
    _check(sources, seed, level, limits)
    wanted = _checked_trials(limits.most_trials if trials is None else trials, level)
    size = max(BATCH, math.ceil(100.0 / (1.0 - level)))
    quantities = values_of(model, np.zeros((1, sum(s.width for s in sources)))).shape[1]
    given = quantity_names(names, quantities)
    least = min(size, wanted) if trials is None else trials
    wanted = min(wanted, _trials_in_memory(quantities, least, limits.most_bytes))
    batches: list[NDArray[np.float64]] = []
    stability, done, settled = Stability(limits.digits, level, limits.interval), 0, False
    while done < wanted and not (trials is None and settled):
        errors = _errors(sources, (seed, len(batches)), size)[: wanted - done]
        parts: list[NDArray[np.float64]] = []
        for start in range(0, len(errors), limits.rows):
            parts.append(values_of(model, errors[start : start + limits.rows], quantities))
            done += len(parts[-1])
            if progress is not None:
                progress(done, trials)
        batches.append(np.concatenate(parts))
        if len(errors) == size:
            settled = stability.settled_with(batches[-1])
    return summary(batches, given, level, settled, limits.digits)


def _trials_in_memory(quantities: int, trials: int, most_bytes: int) -> int:
    """Return the number of trials whose values fit the allowed memory.

    Raises:
        TooManyTrials: fewer than `trials` fit.
    """
    room = most_bytes // (8 * quantities)
    if trials > room:
        raise TooManyTrials(
            f"{number_of(most_bytes, 'byte holds', 'bytes hold')} {number_of(room, 'trial')} of "
            f"{number_of(quantities, 'quantity', 'quantities')}; {trials} are needed"
        )
    return room


def _check(sources: Sequence[Input], seed: int, level: float, limits: TrialLimits) -> None:
    """Check the arguments before the first trial.

    Raises:
        BadInput: a number or a name is outside its domain.
    """
    check_level(level)
    check_names(sources)
    for name, number, least in (("seed", seed, 0), ("digits", limits.digits, 1), ("rows", limits.rows, 1)):
        if number < least:
            raise BadInput(f"{name} is {number}; it must be at least {least}")
    if limits.interval not in get_args(IntervalKind):
        raise BadInput(f"interval is {limits.interval!r}; it must be one of {', '.join(get_args(IntervalKind))}")


def _checked_trials(trials: int, level: float) -> int:
    """Return the number of trials if it is large enough for values outside and inside an interval of this level.

    Raises:
        BadInput: the number of trials is too small.
    """
    if not 0 < math.floor(level * trials + 0.5) < trials:
        raise BadInput(
            f"{number_of(trials, 'trial does', 'trials do')} not reach a coverage probability of {level}; at least "
            f"{math.floor(0.5 / (1.0 - level)) + 1} are needed"
        )
    return trials


def _errors(sources: Sequence[Input], stream: tuple[int, int], size: int) -> NDArray[np.float64]:
    """Return the errors of a batch of trials, shape (size, columns); each source has its own random stream."""
    drawn = [
        source.draw(np.random.default_rng([*stream, i]), size).reshape(size, source.width)
        for i, source in enumerate(sources)
    ]
    return np.concatenate([np.zeros((size, 0)), *drawn], axis=1)
