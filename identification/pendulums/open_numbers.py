# pyright: strict
"""A transient with some known numbers left open within their standard uncertainties.

A release multiplies what its masses are off by: 0.05 % of a pendulum's mass, which a laboratory's balance leaves, moves
its angles by tens of standard deviations. A fit that takes the mass as exact then finds friction that is not there, or
does not follow. With θ extended by the numbers' errors, in standard deviations, each with its unit normal prior, the
release finds them itself. What other tests have identified goes with a number (by_number of the knowledge); θ's
suspension is that for the numbers as the rig file has them. Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.signals.threads import THREADS
from identification.pendulums.suspension_knowledge import NAMES, Knowledge
from identification.pendulums.transient import TransientProblem

Array = NDArray[np.float64]

PENDULUMS = ("pendulums.a.mass_kg", "pendulums.a.length_m", "pendulums.b.mass_kg", "pendulums.b.length_m")
"""Numbers that a release shows. The rotor's mass acts as all of these together."""
_FURTHEST = 12.0  # standard deviations of a number
_STEP = 0.1  # of a number's standard uncertainty, for its column


def with_open_numbers(
    problem: TransientProblem,
    knowledge: Knowledge,
    std: Mapping[str, float],
    suspension: slice,
    made: Callable[[Knowledge], TransientProblem],
) -> TransientProblem:
    """The problem with the numbers' errors as last unknowns.

    Args:
        problem: without them, p unknowns.
        knowledge: the problem's.
        std: number → its standard uncertainty, in its unit, k of them.
        suspension: where the logarithms of k1, k2, ζ1, ζ2, S_P stand in θ.
        made: the same problem with other masses and lengths.
    Returns:
        Problem of p + k unknowns.
    """
    names, unit, p = tuple(std), np.array(list(std.values())), len(problem.prior)
    along = np.stack([knowledge.by_number.get(name, np.zeros(len(NAMES))) * std[name] for name in names])

    def angles(theta: Array, off: Array, end_s: float, slopes: bool) -> tuple[Array, Array]:
        moved, own = knowledge, theta.copy()
        for name, step in zip(names, (off * unit).tolist(), strict=True):
            moved = moved.moved(name, step)
        own[suspension] += off @ along
        return made(moved).predict(own, end_s, slopes)

    def predict(theta: Array, end_s: float, slopes: bool = True, /) -> tuple[Array, Array]:
        own, off = theta[:p], theta[p:]
        if not np.max(np.abs(off)) < _FURTHEST:
            count = sum(len(c.time_s) for c in problem.cut(end_s))
            return np.full(count, np.nan), np.zeros((count, len(theta)))
        angle, slope = angles(own, off, end_s, slopes)
        if not slopes:
            return angle, slope

        def column(k: int) -> Array:
            return (angles(own, off + _STEP * np.eye(len(names))[k], end_s, False)[0] - angle) / _STEP

        with ThreadPoolExecutor(THREADS) as pool:  # the motions leave the interpreter to others
            columns = list(pool.map(column, range(len(names))))
        return angle, np.column_stack([slope, *columns])

    none, one = np.zeros(len(names)), np.ones(len(names))
    return replace(problem, predict=predict, prior=np.r_[problem.prior, none], prior_std=np.r_[problem.prior_std, one])
