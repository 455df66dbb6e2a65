"""Search for the instants at which the locks opened.

An error of an instant has nearly the same effect as an error of the start angles and of the disk's start, so a fit may
end in a side minimum whose start lies far from its prior. Such a fit is repeated from the pair of instants that
explains the first readings best.
"""

from __future__ import annotations

import logging
from itertools import product

import numpy as np
from scipy.special import chdtri

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.release_problem import OPENS, OWN_START, RecordedRelease
from identification.pendulums.release_search import holding
from identification.pendulums.transient import TransientProblem
from rig_basics.arrays import Array
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_CHANCE = 1e-3  # probability by chance of a start that counts as doubtful
_REACH_STDS = 2.5  # standard deviations about the messages in which instants are tried
_TRIED = 7  # instants of each lock: 49 pairs, about a second of processor
_ITERATIONS = 6


def is_strained(problem: TransientProblem, minimum: Minimum) -> bool:
    """Return whether a fit's start is further from its prior than chance explains."""
    at = list(OWN_START)
    off = (minimum.theta[at] - problem.prior[at]) / problem.prior_std[at]
    return float(off @ off) > float(chdtri(len(at), _CHANCE))


def opening_start(release: RecordedRelease, problem: TransientProblem, start: Array, end_s: float) -> Array:
    """Return a start value with the pair of instants that explains the readings up to `end_s` best.

    Args:
        release: release to fit.
        problem: its least-squares problem.
        start: start value of the other unknowns.
        end_s: last instant of the first readings, s.
    Raises:
        FitFailed: the motion is not finite from any pair.
    """
    reach = _REACH_STDS * release.opening_std_s
    tried = np.linspace(release.message_s - reach, release.message_s + reach, _TRIED)
    found: list[Minimum] = []
    for pair in product(*tried.T.tolist()):
        theta = start.copy()
        theta[list(OPENS)] = pair
        with ignoring(_log, "fitting from a pair of instants", FitFailed):
            found.append(holding(problem, theta).solve(theta, end_s, _ITERATIONS))
    if not found:
        raise FitFailed("the motion is not finite for any instants at which the locks may have opened")
    return min(found, key=lambda minimum: minimum.cost).theta
