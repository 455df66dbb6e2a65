# pyright: strict
"""Where all releases of a campaign are met best, and each one's fit there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.errors import FitFailed
from identification.pendulums.suspension_knowledge import BOW
from identification.release_check.model import PLACES, Condensed, Fitted, Misfit

_HELD = 1e-9  # std of what is held


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
        misfit: of the fit with everything open.
    """
    minimum, held = fitted.minimum, [PLACES[name] for name in shared if name in PLACES]
    knowledge, moved = fitted.release.knowledge, dict(fitted.moved)
    for name in (*knowledge.numbers, *BOW):
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
    try:
        found = problem.solve(start, fitted.end_s)
    except FitFailed:
        return None
    return Fitted(there, problem, fitted.shape, found, fitted.end_s, moved, misfit) if found.converged else None
