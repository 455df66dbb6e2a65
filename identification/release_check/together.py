# pyright: strict
"""Where all releases of a campaign are met best, and each one's fit there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.suspension_knowledge import BOW
from identification.pendulums.transient import TransientProblem
from identification.release_check.model import PLACES, Condensed, Fitted, Misfit

Array = NDArray[np.float64]

_HELD = 1e-9  # std of what is held
_ITERATIONS = 40
_GOOD, _NO_WORSE = 1.2, 1.1  # χ²/dof, and of the first fit's, that are not looked into


def agreed(found: Sequence[Condensed], worth: Mapping[str, float]) -> dict[str, float]:
    """How far what releases share is from what was assumed where all of them are met best, in the units of the slopes.

    Args:
        worth: standard deviation that each may be off by; what is not in it, or 0, stays.
    """
    names = [name for name in worth if worth[name] > 0 and any(name in each.slopes for each in found)]
    rows, aims = [np.diag([1 / worth[name] for name in names])], [np.zeros(len(names))]
    for each in found:
        std = np.sqrt(np.diag(each.own))
        slopes = [each.slopes.get(name, np.zeros(len(std))) for name in names]
        rows.append(np.column_stack(slopes) / std[:, None])
        aims.append(-each.values / std)
    scale = np.array([worth[name] for name in names])
    shares = np.linalg.lstsq(np.concatenate(rows) * scale, np.concatenate(aims))[0]
    return dict(zip(names, (shares * scale).tolist(), strict=True))


def fitted_at(fitted: Fitted, shared: Mapping[str, float], misfit: Misfit) -> Fitted | None:
    """The fit again with what tests share held at given places; None where it does not settle there.

    A release alone leaves some of that nearly free, and its fit ends where that has wandered. Rows of several releases
    that are linear about different places do not go together to the standard deviation.

    Args:
        shared: a place of θ, or a number's distance above what the file says, by name.
        misfit: of the fit with everything open; one that is better here takes its place.
    """
    minimum, held = fitted.minimum, [PLACES[name] for name in shared if name in PLACES]
    knowledge, moved = fitted.release.knowledge, dict(fitted.moved)
    for name in (*knowledge.numbers, *BOW, *knowledge.terms):
        if name in shared and name != "imbalance.mass_kg":
            knowledge = knowledge.moved(name, shared[name] - moved.get(name, 0.0))
            moved[name] = shared[name]
    there = fitted.release.laid_over(knowledge)
    prior, std = fitted.problem.prior.copy(), fitted.problem.prior_std.copy()
    prior[held] = [shared[name] for name in shared if name in PLACES]
    std[held] = _HELD
    own = np.setdiff1d(np.arange(len(prior)), held)
    start = minimum.theta.copy()
    start[held] = prior[held]
    kept = np.r_[np.ones(fitted.readings, bool), ~np.isin(np.flatnonzero(np.isfinite(std)), held)]
    change = minimum.jacobian[kept][:, held] @ (start - minimum.theta)[held]
    start[own] -= np.linalg.lstsq(minimum.jacobian[kept][:, own], change)[0]
    problem = replace(there.problem(fitted.shape), prior=prior, prior_std=std)
    found = _solved(problem, start, fitted.horizons_s, misfit)
    if found is None:
        return None
    better = problem.chi2_per_dof(found, fitted.end_s) < misfit.chi2_per_dof
    return Fitted(there, problem, fitted.shape, found, fitted.horizons_s, moved, None if better else misfit)


def _solved(problem: TransientProblem, near: Array, horizons_s: Sequence[float], misfit: Misfit) -> Minimum | None:
    """The minimum over the whole, from nearby; else, or where that leaves more than it should, over growing stretches.

    The release's own unknowns then begin where nothing was known of them: a first fit may have ended at a side minimum.
    """
    afresh = np.where(np.isfinite(problem.prior_std), problem.prior, near)
    found: list[Minimum] = []
    for theta, stretches in ((near, horizons_s[-1:]), (afresh, horizons_s)):
        if found and problem.chi2_per_dof(found[0], horizons_s[-1]) < min(_GOOD, _NO_WORSE * misfit.chi2_per_dof):
            break
        try:
            minimum = _grown(problem, theta, stretches)
        except FitFailed:
            continue
        if minimum.converged:
            found.append(minimum)
    return min(found, key=lambda minimum: minimum.cost, default=None)


def _grown(problem: TransientProblem, theta: Array, stretches_s: Sequence[float]) -> Minimum:
    """The minimum over the last stretch, each begun where the one before ended."""
    *early, last = stretches_s
    for end in early:
        theta = problem.solve(theta, end, _ITERATIONS).theta
    return problem.solve(theta, last, _ITERATIONS)
