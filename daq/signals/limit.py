# pyright: strict
"""Where an approach ends: the limit of slowly settling means with a covariance, averaged over models and rates.

Window means of q quantities approach their limits together, m(t) = m∞ + Σ a_i e^{−λ_i (t−T)} with T the end of the
last window: the rates are common (they are the motion's own), the amplitudes a_i free for each quantity. Four models
are compared: none (the means stand), one rate, two rates, one decaying oscillation; rates may have the square of their
part beside them, of a size that is known beforehand. They weigh by their marginal likelihood, so the covariance holds
what the noise leaves where the rates are known, what the rates leave, and what the choice of the model leaves. A
fifth, straight lines and growth, has no limit; its share of the posterior is reported.

An approach is exponential only near its end: 15 % of the change that is extrapolated beyond the last window is added as
a standard deviation of its own.
Source: docs/theory/steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.signals.approach_models import ENDING, ENDING_BENT, ENDLESS, Points, Stretch

Array = NDArray[np.float64]
Bends = Callable[[Array], Array]

LEAST_WINDOWS = 9
MODEL_SHARE = 0.15  # of the extrapolated change: an approach is exponential only near its end
_SHORTER = 0.7  # of the windows are kept when no model fits all
_FITS = 2.6  # deviations above its mean that the χ² of a stretch that fits has at most: about 1 %
_APART = 2.6  # deviations that the limit of a stretch may be off that of its later part
_LEAST_GAIN = 0.1  # of that part's variance: the difference of the two is not taken smaller
_WORST_SCATTER = 9.0  # variance of the means over that of their noise: more is explained by no model here
_MOVES = 0.5  # share of the posterior from which on a rate is stated
_MOST_ENDLESS = 0.5  # share of the posterior


@dataclass(frozen=True)
class Limit:
    """Where an approach ends.

    Attributes:
        values: limits m∞, shape (q,), unit of the means.
        covariance: of the limits, shape (q, q).
        to_come: limit minus the motion at the end of the last window, shape (q,).
        weights: posterior share of "none", "one rate", "two rates" and "oscillation"; sum 1.
        endless: posterior share of straight lines and growth before they were left out.
        rate_per_s: posterior mean of the rate with the largest change to come, 1/s; nan where the means stand.
        windows: how many of the newest windows were used.
        scatter: factor on each quantity's noise variance, shape (q,): 1 where the means scatter as their noise allows.
    """

    values: Array
    covariance: Array
    to_come: Array
    weights: dict[str, float]
    endless: float
    rate_per_s: float
    windows: int
    scatter: Array

    @property
    def model(self) -> str:
        """The model with the largest share."""
        return max(self.weights, key=lambda name: self.weights[name])


def limit(edges_s: Array, means: Array, noise: Array, bends: Bends | None = None) -> Limit | None:
    """Limits of quantities that approach them with the same rates.

    Args:
        edges_s: start and end of each window, shape (n, 2), s, in order, n ≥ 9.
        means: shape (n, q).
        noise: covariance of each quantity's errors over the windows, shape (q, n, n): noise of the means on the
            diagonal, and what windows have in common (a code that stands) beside it.
        bends: from a stretch's means to the prior deviation of what an approach's square changes over it, shape (q,),
            unit of the means: close to an end a single rate's motion is m∞ + a u + b u², u = e^{−λ(t−T)}. None: b = 0.
    Returns:
        From the longest stretch of the newest windows that a model fits, the early ones by themselves as well: what is
        not exponential there yet is lost in the χ² of the whole, and pulls the limit all the same. Where none fits,
        from the one fitted best, its noise widened to its scatter. None where no stretch is explained, or where
        straight lines and growth explain it best.
    """
    known = np.ones(means.shape[1])
    least, count, scatter = math.inf, 0, known
    tails = _tails(len(means))
    found = _look(edges_s, means, noise, tails[0], bends)
    for tail, shorter in zip(tails, [*tails[1:], None], strict=True):
        later = _look(edges_s, means, noise, shorter, bends) if shorter else None
        if found.fits and (later is None or found.continues(later)):
            return _stated(found, later, known)
        spread = float(found.chi2.sum()) / (found.dof * found.chi2.size)
        if spread < least:
            least, count, scatter = spread, tail, np.maximum(found.chi2 / found.dof, 1.0)
        found = later or found
    if least > _WORST_SCATTER:
        return None
    return _stated(_look(edges_s, means, noise * scatter[:, None, None], count, bends), None, scatter)


def _look(edges_s: Array, means: Array, noise: Array, tail: int, bends: Bends | None) -> _Averaged:
    """Every model on the newest windows."""
    seen = means[-tail:]
    return _average(Stretch(edges_s[-tail:], seen, noise[:, -tail:, -tail:], bends(seen) if bends else None))


def _stated(found: _Averaged, later: _Averaged | None, scatter: Array) -> Limit | None:
    """The limit of a stretch; where that of its later part is another one, between the two, as wide as both."""
    if found.endless > _MOST_ENDLESS:
        return None
    own = found.limit(scatter)
    if later is None:
        return own
    other = later.limit(scatter)
    off = other.values - own.values
    variance = np.diag(other.covariance)
    gain = np.maximum(variance - np.diag(own.covariance), _LEAST_GAIN * variance)
    half = np.where(off**2 > _APART**2 * gain, 0.5 * off, 0.0)
    return replace(own, values=own.values + half, covariance=own.covariance + np.diag(half**2))


def _tails(count: int) -> list[int]:
    """How many of the newest windows to look at, most first."""
    tails = [count]
    while tails[-1] > LEAST_WINDOWS:
        tails.append(max(LEAST_WINDOWS, int(tails[-1] * _SHORTER)))
    return tails


@dataclass(frozen=True)
class _Averaged:
    """The models of one stretch.

    Attributes:
        looks: points of each model that ends, by name.
        endless: posterior share of straight lines and growth.
        windows: of the stretch.
    """

    looks: dict[str, Points]
    endless: float
    windows: int

    @property
    def _best(self) -> Points:
        return max(self.looks.values(), key=lambda points: float(points.evidence.max()))

    @property
    def chi2(self) -> Array:
        """Of the residuals of the most probable point of all, shape (q,)."""
        return np.asarray(self._best.chi2[int(np.argmax(self._best.evidence))], np.float64)

    @property
    def dof(self) -> float:
        """Degrees of freedom of that for each quantity."""
        own, shared = self._best.unknowns
        return self.windows - own - shared / self._best.chi2.shape[1]

    @property
    def fits(self) -> bool:
        """Whether noise alone leaves such residuals in more than about one of a hundred cases."""
        return _fits(float(self.chi2.sum()), self.dof * self.chi2.size)

    def continues(self, later: _Averaged) -> bool:
        """Whether the windows before a shorter stretch fit as well."""
        return _fits(float(self.chi2.sum() - later.chi2.sum()), (self.dof - later.dof) * self.chi2.size)

    def limit(self, scatter: Array) -> Limit:
        """The mean over all points."""
        evidence = np.concatenate([points.evidence for points in self.looks.values()])
        weight = np.exp(evidence - _log_sum([evidence]))
        weights = {name: math.exp(_log_sum([p.evidence]) - _log_sum([evidence])) for name, p in self.looks.items()}
        values, variance, left, size, rates = (
            np.concatenate([getattr(points, name) for points in self.looks.values()])
            for name in ("values", "variance", "left", "size", "rate_per_s")
        )
        mean = weight @ values
        off = values - mean
        own = weight @ (variance + (MODEL_SHARE * size) ** 2)
        moving = np.isfinite(rates)
        share = float(weight[moving].sum())
        rate = float(weight[moving] @ rates[moving]) / share if share > _MOVES else math.nan
        covariance = np.diag(own) + (off * weight[:, None]).T @ off
        return Limit(mean, covariance, weight @ left, weights, self.endless, rate, self.windows, scatter)


def _average(stretch: Stretch) -> _Averaged:
    """Every model's posterior on one stretch."""
    looks = {"none": stretch.standing()}
    for family in ENDING_BENT if stretch.bent else ENDING:
        looks[family.name] = stretch.integrated(family, max(float(p.evidence.max()) for p in looks.values()))
    most = max(float(points.evidence.max()) for points in looks.values())
    endless = _log_sum([stretch.integrated(ENDLESS, most).evidence])
    ending = _log_sum([points.evidence for points in looks.values()])
    return _Averaged(looks, 1 / (1 + math.exp(min(ending - endless, 700.0))), len(stretch.edges_s))


def _fits(chi2: float, dof: float) -> bool:
    return chi2 <= dof + _FITS * math.sqrt(2 * max(dof, 0.0))


def _log_sum(evidence: Sequence[Array]) -> float:
    """log Σ e^x over all."""
    joined = np.concatenate(evidence)
    most = float(joined.max())
    return most + math.log(float(np.exp(joined - most).sum()))
