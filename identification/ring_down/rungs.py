# pyright: strict
"""The rungs of a ring-down's ladder above constant rates: frequency, and damping ratio, that depend on amplitude.

Each mode has two: its frequency, its damping ratio. The one that lowers χ² most is taken as long as that is worth
more than BIC asks; none is kept that is not certain in the end. Where one direction has a term, the other one is
likely to have it too, even if its motion is too small to show it: it is then fitted there with a prior about zero,
so that the interval of the value at zero amplitude covers it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs]

from identification.errors import FitFailed
from identification.least_squares import solve_separable
from identification.ring_down.averaging import with_terms
from identification.ring_down.backbone import REFERENCE_M, Backbone, Floats
from identification.ring_down.decay import Fitted, Priors, prior_std, solve
from identification.ring_down.disturbances import mode_size
from identification.ring_down.model import DecayModel
from identification.ring_down.modes import rate
from identification.ring_down.residuals import gain_of
from identification.ring_down.scores import known_columns, stretches

_WORTH = 2.0  # of BIC, beyond 0: a term that is missed biases more than one that is not there costs
_CHANCE = 1e-3  # that noise alone is worth a term, in a fit
_CERTAIN = 3.0  # standard deviations
_ALIKE = 2.0  # times one direction's term: what the other one's is likely to be at most
_APART = 3.0  # half-bandwidths; of nearer modes a beat looks like rates that change
_GROWS, _FAST = -1e-3, 0.25  # damping ratios between which an amplitude falls slowly against a cycle
_MISFIT, _MOSTLY = 6.0, 0.7  # standard deviations of χ²/dof; share of what is beyond noise
_BENT = (-0.02, -0.005, -0.001, 0.001, 0.005, 0.02)  # relative change of frequency at the largest amplitude
_DRAGGED = (-0.5, 0.2, 0.5, 1.5)  # of ζ
_LOOKS = 3  # iterations from each start
_MEAN_SQUARE, _MEAN = 0.4, 0.6  # of the largest amplitude, over what tells the rates

Taken = tuple[bool, ...]


def climbed(fitted: Fitted, priors: Priors, first: bool) -> Fitted:
    """The fit with the terms of amplitude that the data ask for, and without those that they no longer do.

    Args:
        priors: of a turned pair.
        first: before lines and coloured noise are known: terms are taken only if they explain most of a misfit.
    """
    if (first and not is_misfit(fitted)) or not _are_suited(fitted):
        return fitted
    best = _highest(fitted, priors)
    if first:
        return best if explains(fitted, best) else fitted
    return _with_plausible(_certain(best, priors), priors)


def _highest(fitted: Fitted, priors: Priors) -> Fitted:
    """The fit with one term after the other as long as they are worth it."""
    for _ in range(2 * fitted.model.modes):
        higher = _next(fitted, priors)
        if higher is None:
            break
        fitted = higher
    return fitted


def is_misfit(fitted: Fitted) -> bool:
    """Whether χ² is beyond what noise makes it."""
    dof = _dof(fitted)
    return fitted.chi2 - dof > _MISFIT * np.sqrt(2 * dof)


def explains(fitted: Fitted, other: Fitted) -> bool:
    """Whether another fit explains most of what a fit leaves beyond noise."""
    return fitted.chi2 - other.chi2 > _MOSTLY * (fitted.chi2 - _dof(fitted))


def _dof(fitted: Fitted) -> int:
    return fitted.count - fitted.model.linear - fitted.model.free


def bent_leader(fitted: Fitted, priors: Priors) -> Fitted | None:
    """The stronger mode of a turned pair as one mode in both sensors; None where its rates are constant."""
    alone = replace(fitted.model, modes=1, turned=False, delays=False, backbone=None)
    strong = 2 * int(np.argmax([mode_size(fitted, mode) for mode in range(2)]))
    single = _highest(solve(fitted.decay, alone, [fitted.theta[strong : strong + 2]], priors), priors)
    return single if single.model.backbone is not None else None


def beside_leader(model: DecayModel, leader: Fitted, other: Floats, place: int) -> tuple[DecayModel, Floats]:
    """A turned pair and start values from its stronger mode, fitted alone, and the other one's rates.

    Args:
        leader: one mode whose rates depend on amplitude.
        other: ln ω and ζ.
        place: the leader's in the pair.
    """
    own = leader.model.backbone
    assert own is not None
    order = (0, 1) if place == 0 else (1, 0)
    both = Backbone(
        (own.hardens[0], False), (own.drags[0], False), tuple((one[0], 0.0) for one in own.amplitudes_m)
    ).in_order(order)
    parts = (leader.theta[:2], other), (leader.theta[2:4], np.zeros(2))
    rates, terms = (np.concatenate([part[i] for i in order]) for part in parts)
    return replace(model, backbone=both), np.concatenate([rates, np.zeros(model.tail - 4), terms])


def _are_suited(fitted: Fitted) -> bool:
    """Whether the modes' amplitudes fall slowly, and by themselves: averaging needs the one, telling them the other."""
    if not np.all((fitted.zetas > _GROWS) & (fitted.zetas < _FAST)):
        return False
    lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    return len(lams) < 2 or abs(lams[0] - lams[1]) > _APART * max(abs(lam.real) for lam in lams)


def _taken(fitted: Fitted) -> Taken:
    backbone = fitted.model.backbone
    return backbone.taken if backbone is not None else (False,) * (2 * fitted.model.modes)


def _next(fitted: Fitted, priors: Priors) -> Fitted | None:
    """The fit with the one more term that explains most; None where none is worth it."""
    price = max(float(np.log(fitted.count)) + _WORTH, float(chdtri(1, _CHANCE / (2 * fitted.model.modes))))
    gains, taken = _gains(fitted), _taken(fitted)
    noise = max(1.0, fitted.solution.chi2_per_dof)
    worth = [i for i, gain in enumerate(gains) if not taken[i] and gain / noise > price]
    fits = [f for f in (_with(fitted, i, priors) for i in worth) if f is not None]
    if not fits:
        return None
    best = min(fits, key=lambda f: f.chi2)
    band = float(np.max(stretches(best)[: 2 * best.model.modes])) ** 2  # noise above white where the modes are
    return best if (fitted.chi2 - best.chi2) / band > price else None


def _gains(fitted: Fitted) -> Floats:
    """By how much χ² would fall with each single term, shape (2 × modes,): score tests."""
    model, theta = with_terms(
        fitted.model, fitted.theta, fitted.solution.coefficients, (True,) * (2 * fitted.model.modes)
    )
    known, residuals = known_columns(fitted)
    gains = np.zeros(2 * model.modes)
    held = np.array(_taken(fitted)) if fitted.model.backbone is not None else None
    for block, c, columns, residual in zip(model(theta), fitted.solution.coefficients, known, residuals, strict=True):
        tail = block.tangent(c)[:, model.tail :]
        moved = columns if held is None else np.hstack([columns[:, : -len(held)], tail[:, held]])
        if np.all(np.isfinite(tail)):
            gains += [gain_of(residual, moved, tail[:, i : i + 1]) for i in range(len(gains))]
    return gains


def _with(fitted: Fitted, index: int, priors: Priors) -> Fitted | None:
    """The fit with one more term, from the best of some start values."""
    taken = tuple(on or i == index for i, on in enumerate(_taken(fitted)))
    model, theta = with_terms(fitted.model, fitted.theta, fitted.solution.coefficients, taken)
    std = prior_std(model, priors)
    looks: list[tuple[float, Floats]] = []
    for start in _starts(model, theta, index):
        if model.is_absurd(start):
            continue
        try:
            found = solve_separable(model, start, np.zeros(model.size), std, _LOOKS).minimum
        except FitFailed:
            continue
        looks.append((found.cost, found.theta))
    if not looks:
        return None
    return solve(fitted.decay, model, [min(looks, key=lambda look: look[0])[1]], priors)


def _starts(model: DecayModel, theta: Floats, index: int) -> list[Floats]:
    """θ with the rates at zero amplitude moved so that those over the whole decay stay."""
    backbone, mode = model.backbone, index // 2
    assert backbone is not None
    level = backbone.largest_m[mode] / REFERENCE_M
    out = [theta]
    for value in _DRAGGED if index % 2 else _BENT:
        own = theta.copy()
        if index % 2:
            change = value * abs(float(theta[2 * mode + 1]))
            own[2 * mode + 1] -= _MEAN * change
            own[model.tail + index] = change / level
        else:
            own[2 * mode] -= _MEAN_SQUARE * value
            own[model.tail + index] = value / level**2
        out.append(own)
    return out


def _certain(fitted: Fitted, priors: Priors) -> Fitted:
    """The fit without terms that are not certain, the least certain left out first."""
    while fitted.model.backbone is not None:
        model, taken = fitted.model, _taken(fitted)
        std = np.sqrt(np.diag(fitted.solution.minimum.covariance)) * stretches(fitted)
        sure = np.abs(fitted.theta[model.tail :]) / std[model.tail :]
        weak = min((i for i, on in enumerate(taken) if on), key=lambda i: float(sure[i]))
        if sure[weak] > _CERTAIN:
            return fitted
        left = tuple(on and i != weak for i, on in enumerate(taken))
        lower, theta = with_terms(model, fitted.theta, fitted.solution.coefficients, left)
        fitted = solve(fitted.decay, lower, [theta], priors)
    return fitted


def _with_plausible(fitted: Fitted, priors: Priors) -> Fitted:
    """The fit with a term that one direction has opened in the other one too, as far as it is likely to be there."""
    backbone, modes = fitted.model.backbone, fitted.model.modes
    if backbone is None or modes < 2:
        return fitted
    values, plausible = np.abs(fitted.theta[fitted.model.tail :]), np.zeros(2 * modes)
    for i, on in enumerate(backbone.taken):
        if not on:
            plausible[i] = _ALIKE * max((float(values[j]) for j in range(i % 2, 2 * modes, 2)), default=0.0)
    if not plausible.any():
        return fitted
    return solve(
        fitted.decay,
        replace(fitted.model, backbone=replace(backbone, plausible=tuple(plausible))),
        [fitted.theta],
        priors,
    )
