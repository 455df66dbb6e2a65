"""Terms of amplitude of a ring-down: selection of frequencies and damping ratios that depend on amplitude.

Each mode has two possible terms, for its frequency and for its damping ratio. The term that reduces χ² most is added as
long as the gain exceeds BIC's penalty. Terms that are not significant in the end are removed. If one direction has a
term, the other direction is likely to have it too, even if its motion is too small to show it. It is then fitted there
with a prior about zero, so that the interval of the value at zero amplitude covers it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from identification.ring_down.averaging import with_terms
from identification.ring_down.backbone import REFERENCE_M, Backbone
from identification.ring_down.decay import FittedDecay, Priors, best_start, solve
from identification.ring_down.disturbances import mode_size
from identification.ring_down.model import DecayModel
from identification.ring_down.modes import rate
from identification.ring_down.residuals import gain_of
from identification.ring_down.scores import known_columns, stretches
from rig_basics.arrays import Array

_MIN_BIC_GAIN = 2.0  # of BIC; small, since a missing term biases more than a superfluous one widens
_FALSE_ALARM_RATE = 1e-3  # probability that noise alone adds a term to a fit
_MIN_SIGNIFICANCE = 3.0  # standard deviations
_PRIOR_RATIO = 2.0  # prior standard deviation of a direction's term over the other direction's term
_MIN_SPLIT = 3.0  # half-bandwidths; the beat of closer modes looks like changing rates
_MIN_ZETA, _MAX_ZETA = -1e-3, 0.25  # damping ratios for which the amplitude changes slowly over a cycle
_MIN_MISFIT_STD, _MIN_EXPLAINED = 6.0, 0.7  # standard deviations of χ²/dof; explained share of the misfit
_FREQUENCY_CHANGES = (-0.02, -0.005, -0.001, 0.001, 0.005, 0.02)  # relative, at the largest amplitude
_DAMPING_CHANGES = (-0.5, 0.2, 0.5, 1.5)  # relative to ζ, at the largest amplitude
_MEAN_SQUARE, _MEAN = 0.4, 0.6  # of the relative amplitude over the part of the decay that determines the rates

Taken = tuple[bool, ...]


def climbed(fitted: FittedDecay, priors: Priors, first: bool) -> FittedDecay:
    """Add the terms of amplitude that the data require, and remove those that are not significant.

    Args:
        fitted: solved fit.
        priors: priors of a turned pair.
        first: whether lines and coloured noise are not yet known. Terms are then added only if they explain most of a
            misfit.
    """
    if (first and not is_misfit(fitted)) or not _are_suited(fitted):
        return fitted
    best = _highest(fitted, priors)
    if first:
        return best if explains(fitted, best) else fitted
    return _with_plausible(_certain(best, priors), priors)


def _highest(fitted: FittedDecay, priors: Priors) -> FittedDecay:
    """Add one term after the other as long as the gain exceeds the penalty."""
    for _ in range(2 * fitted.model.modes):
        higher = _next(fitted, priors)
        if higher is None:
            break
        fitted = higher
    return fitted


def is_misfit(fitted: FittedDecay) -> bool:
    """Whether χ² is significantly above its value for noise."""
    dof = _dof(fitted)
    return fitted.chi2 - dof > _MIN_MISFIT_STD * np.sqrt(2 * dof)


def explains(fitted: FittedDecay, other: FittedDecay) -> bool:
    """Whether another fit explains most of the misfit of a fit."""
    return fitted.chi2 - other.chi2 > _MIN_EXPLAINED * (fitted.chi2 - _dof(fitted))


def _dof(fitted: FittedDecay) -> int:
    return fitted.count - fitted.model.linear - fitted.model.free


def bent_leader(fitted: FittedDecay, priors: Priors) -> FittedDecay | None:
    """Fit of the stronger mode of a turned pair as one mode in both sensors; None if its rates are constant."""
    alone = replace(fitted.model, modes=1, turned=False, delays=False, backbone=None)
    strong = 2 * int(np.argmax([mode_size(fitted, mode) for mode in range(2)]))
    single = _highest(solve(fitted.decay, alone, [fitted.theta[strong : strong + 2]], priors), priors)
    return single if single.model.backbone is not None else None


def pair_with_leader(model: DecayModel, leader: FittedDecay, other: Array, place: int) -> tuple[DecayModel, Array]:
    """Return a turned pair and its start values from the separate fit of its stronger mode and the other one's rates.

    Args:
        model: model of the pair.
        leader: fit of one mode whose rates depend on amplitude.
        other: ln ω and ζ of the other mode.
        place: index of the leader in the pair.
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


def _are_suited(fitted: FittedDecay) -> bool:
    """Whether amplitudes change slowly, which averaging requires, and modes are separate, which resolution requires."""
    if not np.all((fitted.zetas > _MIN_ZETA) & (fitted.zetas < _MAX_ZETA)):
        return False
    lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    return len(lams) < 2 or abs(lams[0] - lams[1]) > _MIN_SPLIT * max(abs(lam.real) for lam in lams)


def _taken(fitted: FittedDecay) -> Taken:
    backbone = fitted.model.backbone
    return backbone.taken if backbone is not None else (False,) * (2 * fitted.model.modes)


def _next(fitted: FittedDecay, priors: Priors) -> FittedDecay | None:
    """Fit with the additional term that explains most; None if no gain exceeds the penalty."""
    chance = _FALSE_ALARM_RATE / (2 * fitted.model.modes)
    price = max(float(np.log(fitted.count)) + _MIN_BIC_GAIN, float(chdtri(1, chance)))
    gains, taken = _gains(fitted), _taken(fitted)
    noise = max(1.0, fitted.solution.chi2_per_dof)
    worth = [i for i, gain in enumerate(gains) if not taken[i] and gain / noise > price]
    fits = [f for f in (_with(fitted, i, priors) for i in worth) if f is not None]
    if not fits:
        return None
    best = min(fits, key=lambda f: f.chi2)
    band = float(np.max(stretches(best)[: 2 * best.model.modes])) ** 2  # noise in the modes' band over white noise
    return best if (fitted.chi2 - best.chi2) / band > price else None


def _gains(fitted: FittedDecay) -> Array:
    """Reduction of χ² by each single term, shape (2 × modes,), from score tests."""
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


def _with(fitted: FittedDecay, index: int, priors: Priors) -> FittedDecay | None:
    """Fit with one more term, from the best of several start values."""
    taken = tuple(on or i == index for i, on in enumerate(_taken(fitted)))
    model, theta = with_terms(fitted.model, fitted.theta, fitted.solution.coefficients, taken)
    start = best_start(model, _starts(model, theta, index), priors)
    return None if start is None else solve(fitted.decay, model, [start], priors)


def _starts(model: DecayModel, theta: Array, index: int) -> list[Array]:
    """Start values of θ: the rates at zero amplitude are shifted so that the mean rates over the decay are kept."""
    backbone, mode = model.backbone, index // 2
    assert backbone is not None
    level = backbone.largest_m[mode] / REFERENCE_M
    out = [theta]
    for value in _DAMPING_CHANGES if index % 2 else _FREQUENCY_CHANGES:
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


def _certain(fitted: FittedDecay, priors: Priors) -> FittedDecay:
    """Fit without terms that are not significant. The least significant term is removed first."""
    while fitted.model.backbone is not None:
        model, taken = fitted.model, _taken(fitted)
        std = np.sqrt(np.diag(fitted.solution.minimum.covariance)) * stretches(fitted)
        significance = np.abs(fitted.theta[model.tail :]) / std[model.tail :]
        weak = min((i for i, on in enumerate(taken) if on), key=lambda i: float(significance[i]))
        if significance[weak] > _MIN_SIGNIFICANCE:
            return fitted
        left = tuple(on and i != weak for i, on in enumerate(taken))
        lower, theta = with_terms(model, fitted.theta, fitted.solution.coefficients, left)
        fitted = solve(fitted.decay, lower, [theta], priors)
    return fitted


def _with_plausible(fitted: FittedDecay, priors: Priors) -> FittedDecay:
    """Fit in which a term of one direction is also opened in the other one, with a prior of its likely size."""
    backbone, modes = fitted.model.backbone, fitted.model.modes
    if backbone is None or modes < 2:
        return fitted
    values, plausible = np.abs(fitted.theta[fitted.model.tail :]), np.zeros(2 * modes)
    for i, on in enumerate(backbone.taken):
        if not on:
            plausible[i] = _PRIOR_RATIO * max((float(values[j]) for j in range(i % 2, 2 * modes, 2)), default=0.0)
    if not plausible.any():
        return fitted
    return solve(
        fitted.decay,
        replace(fitted.model, backbone=replace(backbone, plausible=tuple(plausible))),
        [fitted.theta],
        priors,
    )
