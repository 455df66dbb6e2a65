"""Parameters that fit all releases of a campaign best, and the fit of each release at them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.transient import TransientProblem
from identification.release_check.model import PLACES, Condensed, FittedRelease, Misfit
from rig_basics.arrays import Array
from rig_configs.known import BOW

_log = logging.getLogger(__name__)

_HELD = 1e-9  # prior standard deviation of a held unknown
_ITERATIONS = 40
_GOOD = 1.2  # χ²/dof below which a fit is accepted without a second start
_NO_WORSE = 1.1  # the same bound as a multiple of the first fit's χ²/dof


def agreed(found: Sequence[Condensed], relevant: Mapping[str, float]) -> dict[str, float]:
    """Return the deviations of the shared unknowns from their assumed values that fit all releases best.

    Args:
        found: rows of the releases.
        relevant: prior standard deviation of each unknown; an unknown that is missing or has 0 is not changed.
    Returns:
        Name → deviation, in the units of the slopes.
    """
    names = [name for name in relevant if relevant[name] > 0 and any(name in each.slopes for each in found)]
    rows, aims = [np.diag([1 / relevant[name] for name in names])], [np.zeros(len(names))]
    for each in found:
        std = np.sqrt(np.diag(each.own))
        slopes = [each.slopes.get(name, np.zeros(len(std))) for name in names]
        rows.append(np.column_stack(slopes) / std[:, None])
        aims.append(-each.values / std)
    scale = np.array([relevant[name] for name in names])
    shares = np.linalg.lstsq(np.concatenate(rows) * scale, np.concatenate(aims))[0]
    return dict(zip(names, (shares * scale).tolist(), strict=True))


def fitted_at(fitted: FittedRelease, shared: Mapping[str, float], misfit: Misfit) -> FittedRelease | None:
    """Repeat a fit with the shared unknowns held at given values; return None if it does not converge.

    One release leaves some shared unknowns nearly free, so that they drift in its fit. Rows of several releases that
    are linearised at different points are not consistent to within a standard deviation.

    Args:
        fitted: fit of a release.
        shared: value of a component of θ, or difference of a number from that of the rig file, by name.
        misfit: misfit of the fit with all parameters free. If the new fit is better, its own misfit is used.
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
    return FittedRelease(there, problem, fitted.shape, found, fitted.horizons_s, moved, None if better else misfit)


def _solved(problem: TransientProblem, near: Array, horizons_s: Sequence[float], misfit: Misfit) -> Minimum | None:
    """Return the minimum over the whole stretch, from a near start value or over growing stretches.

    The growing stretches are used if the first fit fails or its residual is too large. The release's own unknowns then
    start at their prior values, since the first fit may have ended at a side minimum.
    """
    from_prior = np.where(np.isfinite(problem.prior_std), problem.prior, near)
    found: list[Minimum] = []
    for theta, stretches in ((near, horizons_s[-1:]), (from_prior, horizons_s)):
        if found and problem.chi2_per_dof(found[0], horizons_s[-1]) < min(_GOOD, _NO_WORSE * misfit.chi2_per_dof):
            break
        try:
            minimum = _grown(problem, theta, stretches)
        except FitFailed as error:
            _log.debug("a start of the joint fit is left out: %s", error)
            continue
        if minimum.converged:
            found.append(minimum)
    return min(found, key=lambda minimum: minimum.cost, default=None)


def _grown(problem: TransientProblem, theta: Array, stretches_s: Sequence[float]) -> Minimum:
    """Return the minimum over the last stretch; each stretch starts from the minimum of the one before."""
    *early, last = stretches_s
    for end in early:
        theta = problem.solve(theta, end, _ITERATIONS).theta
    return problem.solve(theta, last, _ITERATIONS)
