"""A transient with free known numbers, such as masses and lengths, within their standard uncertainties.

A release amplifies errors of its masses: 0.05 % of a pendulum's mass, the error of a laboratory balance, moves its
angles by tens of standard deviations. A fit with an exact mass then finds friction that does not exist, or does not
follow. Here θ is extended by the numbers' errors in standard deviations, each with a unit normal prior, so the release
estimates them. Results of other tests change with a number (by_number of the prior knowledge). The suspension in θ is
that for the numbers of the rig file. The result contains the derivative by a number for the prior alone, without its
part in the fit's own covariance. Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from daq.signals.threads import THREADS
from identification.pendulums.suspension_knowledge import NAMES, Knowledge
from identification.pendulums.transient import TransientProblem
from identification.work import spend
from rig_basics.arrays import Array
from rig_basics.thread_pool import ThreadPool

PENDULUMS = ("pendulums.a.mass_kg", "pendulums.a.length_m", "pendulums.b.mass_kg", "pendulums.b.length_m")
"""Numbers that a release determines. The rotor's mass has the same effect as all of these together."""
_FURTHEST = 12.0  # largest error of a number in standard deviations
_STEP = 0.1  # step of the differences in standard uncertainties


def with_open_numbers(
    problem: TransientProblem,
    knowledge: Knowledge,
    std: Mapping[str, float],
    suspension: slice,
    made: Callable[[Knowledge], TransientProblem],
) -> TransientProblem:
    """Return a problem with the numbers' errors as last unknowns.

    Args:
        problem: problem without them, with p unknowns.
        knowledge: prior knowledge of the problem.
        std: number → its standard uncertainty, in its unit, for k numbers.
        suspension: indices of the logarithms of k1, k2, ζ1, ζ2, S_P in θ.
        made: creates the same problem with other masses and lengths.
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

        spend(len(names) * len(angle) * p)  # the threads do not count their work
        with ThreadPool(THREADS) as pool:  # the compiled motion releases the interpreter lock
            columns = list(pool.map(column, range(len(names))))
        return angle, np.column_stack([slope, *columns])

    none, one = np.zeros(len(names)), np.ones(len(names))
    return replace(problem, predict=predict, prior=np.r_[problem.prior, none], prior_std=np.r_[problem.prior_std, one])
