# pyright: strict
"""Propagation of distributions by a Monte Carlo method, with fixed trials or until the numbers are stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from uncertainty.budget import check_names
from uncertainty.coverage import IntervalKind, check_level
from uncertainty.errors import BadInput, TooManyTrials
from uncertainty.group import Input
from uncertainty.model import Model, values_of
from uncertainty.spread import MonteCarlo, quantity_names, summary
from uncertainty.stable_numbers import Stability

Progress = Callable[[int, int | None], None]
"""Takes the trials done and the trials wanted; None while that number is open."""

BATCH = 10_000


def monte_carlo(
    model: Model,
    sources: Sequence[Input],
    *,
    seed: int,
    trials: int | None = None,
    digits: int = 2,
    level: float = 0.95,
    interval: IntervalKind = "symmetric",
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    most_trials: int = 2_000_000,
    most_bytes: int = 512 * 2**20,
    rows: int = BATCH,
) -> MonteCarlo:
    """The joint distribution of a model's quantities under the errors of its sources.

    The errors that one seed gives to a source do not depend on `rows`, on `trials` or on the sources behind it.

    Args:
        model: errors (n, columns) in the sources' units to values (n, quantities); first called with one row of zeros.
        sources: the causes; a group takes as many columns as it has members.
        seed: at least 0.
        trials: how many; None: batches of 10⁴ or, if that is more, 100/(1 − level), until stable.
        digits: significant digits of the standard deviation that are to be stable.
        level: coverage probability of the intervals.
        interval: whose ends are to be stable; those of the shortest one need many more trials.
        names: of the quantities; their numbers from 0 where None.
        progress: called after each call of the model with trials.
        most_trials: where the adaptive procedure ends with `stabilised` False.
        most_bytes: bound on the values kept, 8 bytes a trial and quantity; the adaptive procedure ends there too.
        rows: largest number of trials in one call of the model.

    Raises:
        BadInput: a number or a name is outside its domain.
        BadModel: the model's values have another shape or are not finite.
        TooManyTrials: the values of `trials` trials, or of one batch, exceed `most_bytes`.
    Source: JCGM 101, 7.2 … 7.9; JCGM 102, 7.
    """
    _check(sources, seed, digits, level, interval, rows)
    wanted = _enough(most_trials if trials is None else trials, level)
    size = max(BATCH, math.ceil(100.0 / (1.0 - level)))
    quantities = values_of(model, np.zeros((1, sum(s.width for s in sources)))).shape[1]
    given = quantity_names(names, quantities)
    wanted = min(wanted, _room(quantities, min(size, wanted) if trials is None else trials, most_bytes))
    batches: list[NDArray[np.float64]] = []
    stability, done, settled = Stability(digits, level, interval), 0, False
    while done < wanted and not (trials is None and settled):
        errors = _errors(sources, (seed, len(batches)), size)[: wanted - done]
        parts: list[NDArray[np.float64]] = []
        for start in range(0, len(errors), rows):
            parts.append(values_of(model, errors[start : start + rows], quantities))
            done += len(parts[-1])
            if progress is not None:
                progress(done, trials)
        batches.append(np.concatenate(parts))
        if len(errors) == size:
            settled = stability.settled_with(batches[-1])
    return summary(batches, given, level, settled, digits)


def _room(quantities: int, trials: int, most_bytes: int) -> int:
    """Trials whose values fit the memory allowed.

    Raises:
        TooManyTrials: fewer than are needed.
    """
    room = most_bytes // (8 * quantities)
    if trials > room:
        raise TooManyTrials(f"{most_bytes} bytes hold {room} trials of {quantities} quantities; {trials} are needed")
    return room


def _check(sources: Sequence[Input], seed: int, digits: int, level: float, interval: str, rows: int) -> None:
    """What can be refused before the first trial.

    Raises:
        BadInput: a number or a name is outside its domain.
    """
    check_level(level)
    check_names(sources)
    for name, number, least in (("seed", seed, 0), ("digits", digits, 1), ("rows", rows, 1)):
        if number < least:
            raise BadInput(f"{name} is {number}; it must be at least {least}")
    if interval not in get_args(IntervalKind):
        raise BadInput(f"interval is {interval!r}; it must be one of {', '.join(get_args(IntervalKind))}")


def _enough(trials: int, level: float) -> int:
    """The trials, if they have values outside and inside an interval of this level.

    Raises:
        BadInput: they have not.
    """
    if not 0 < math.floor(level * trials + 0.5) < trials:
        raise BadInput(
            f"{trials} trials do not reach a coverage probability of {level}; at least "
            f"{math.floor(0.5 / (1.0 - level)) + 1} are needed"
        )
    return trials


def _errors(sources: Sequence[Input], stream: tuple[int, int], size: int) -> NDArray[np.float64]:
    """Errors of a whole batch of trials, shape (size, columns); each source from a random stream of its own."""
    drawn = [
        source.draw(np.random.default_rng([*stream, i]), size).reshape(size, source.width)
        for i, source in enumerate(sources)
    ]
    return np.concatenate([np.zeros((size, 0)), *drawn], axis=1)
