"""End of an approach: limit of slowly settling means with a covariance, averaged over models and rates.

Window means of q quantities approach their limits together, m(t) = m∞ + Σ a_i e^{−λ_i (t−T)}, where T is the end of the
last window. The rates are common to all quantities (they belong to the motion); the amplitudes a_i are free for each
quantity. Four models are compared: none (the means are constant), one rate, two rates, one decaying oscillation. To
rates the square of their part may be added, whose size has a prior. The models are weighted by their marginal
likelihood. The covariance therefore contains the noise for known rates, the uncertainty of the rates, and the
uncertainty of the model. The posterior share of a fifth model, straight lines and growth without a limit, is reported.

An approach is exponential only near its end. Therefore 15 % of the change that is extrapolated beyond the last window
is added as a standard deviation.
Source: docs/theory/detection_of_steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.approach_models import ENDING, ENDING_BENT, ENDLESS, Points, WhitenedMeans, joined
from daq.signals.decay import newest_counts
from rig_basics.arrays import Array

Bends = Callable[[Array], Array]

# Error of the models as a share of the extrapolated change: an approach is exponential only near its end.
MODEL_SHARE = 0.15
_FITS = 2.6  # largest deviation of the χ² of a series that fits, in standard deviations: about 1 %
_APART = 2.6  # largest difference between the limits of a series and of its later part, in standard deviations
# Least variance of that difference, as a share of the later part's variance.
_MIN_GAIN = 0.1
_MAX_SCATTER = 9.0  # variance of the means over that of their noise: with more, no model here is accepted
_MIN_MOVING_SHARE = 0.5  # share of the posterior above which a rate is returned
_MAX_ENDLESS_SHARE = 0.5  # share of the posterior


@dataclass(frozen=True)
class ApproachLimit:
    """Limit of an approach.

    Attributes:
        values: limits m∞, shape (q,), unit of the means.
        covariance: covariance of the limits, shape (q, q).
        to_come: limit minus the value at the end of the last window, shape (q,).
        weights: posterior share of "none", "one rate", "two rates" and "oscillation"; sum 1.
        endless: posterior share of straight lines and growth before they were excluded.
        rate_per_s: posterior mean of the rate with the largest remaining change, 1/s; NaN if the means are constant.
        windows: number of newest windows used.
        scatter: factor on each quantity's noise variance, shape (q,); 1 if the means scatter as their noise predicts.
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
        """Name of the model with the largest share."""
        return max(self.weights, key=lambda name: self.weights[name])


def limit(edges_s: Array, means: Array, noise: Array, bends: Bends | None = None) -> ApproachLimit | None:
    """Return the limits of quantities that approach them with the same rates.

    Args:
        edges_s: start and end of each window, shape (n, 2), s, in order, n ≥ 9.
        means: shape (n, q).
        noise: covariance of each quantity's errors over the windows, shape (q, n, n): noise of the means on the
            diagonal, and common errors of windows (a constant code) off the diagonal.
        bends: function of a series' means that returns the prior deviation of the change of an approach's square over
            the series, shape (q,), unit of the means: close to an end the motion of a single rate is
            m∞ + a u + b u², u = e^{−λ(t−T)}. None: b = 0.

    Returns:
        The limit from the longest series of newest windows that a model fits. The early windows must also fit by
        themselves: a part that is not yet exponential hardly changes the χ² of the whole but shifts the limit. If no
        series fits, the limit of the best fit, with its noise widened to its scatter. None if no series is explained,
        or if straight lines and growth explain it best.
    """
    known = np.ones(means.shape[1])
    least, count, scatter = math.inf, 0, known
    tails = newest_counts(len(means))
    found = _look(edges_s, means, noise, tails[0], bends)
    for tail, shorter in zip(tails, [*tails[1:], None], strict=True):
        later = _look(edges_s, means, noise, shorter, bends) if shorter else None
        if found.fits and (later is None or found.continues(later)):
            return _stated(found, later, known)
        spread = float(found.chi2.sum()) / (found.dof * found.chi2.size)
        if spread < least:
            least, count, scatter = spread, tail, np.maximum(found.chi2 / found.dof, 1.0)
        found = later or found
    if least > _MAX_SCATTER:
        return None
    return _stated(_look(edges_s, means, noise * scatter[:, None, None], count, bends), None, scatter)


def _look(edges_s: Array, means: Array, noise: Array, tail: int, bends: Bends | None) -> _Averaged:
    """Fit every model to the newest windows."""
    seen = means[-tail:]
    return _average(WhitenedMeans(edges_s[-tail:], seen, noise[:, -tail:, -tail:], bends(seen) if bends else None))


def _stated(found: _Averaged, later: _Averaged | None, scatter: Array) -> ApproachLimit | None:
    """Return the limit of a series; if its later part has a different limit, the mean of both, as wide as both."""
    if found.endless > _MAX_ENDLESS_SHARE:
        return None
    own = found.limit(scatter)
    if later is None:
        return own
    other = later.limit(scatter)
    off = other.values - own.values
    variance = np.diag(other.covariance)
    gain = np.maximum(variance - np.diag(own.covariance), _MIN_GAIN * variance)
    half = np.where(off**2 > _APART**2 * gain, 0.5 * off, 0.0)
    return replace(own, values=own.values + half, covariance=own.covariance + np.diag(half**2))


@dataclass(frozen=True)
class _Averaged:
    """The models of one series.

    Attributes:
        looks: points of each model that has an end, by name.
        endless: posterior share of straight lines and growth.
        windows: number of windows in the series.
    """

    looks: dict[str, Points]
    endless: float
    windows: int

    @property
    def _best(self) -> Points:
        return max(self.looks.values(), key=lambda points: float(points.evidence.max()))

    @property
    def chi2(self) -> Array:
        """χ² of the residuals at the most probable point of all models, shape (q,)."""
        return np.asarray(self._best.chi2[int(np.argmax(self._best.evidence))], np.float64)

    @property
    def dof(self) -> float:
        """Degrees of freedom of that point for each quantity."""
        own, shared = self._best.unknowns
        return self.windows - own - shared / self._best.chi2.shape[1]

    @property
    def fits(self) -> bool:
        """True if noise alone leaves such residuals in more than about one of a hundred cases."""
        return _fits(float(self.chi2.sum()), self.dof * self.chi2.size)

    def continues(self, later: _Averaged) -> bool:
        """Return True if the windows before a shorter series fit as well."""
        return _fits(float(self.chi2.sum() - later.chi2.sum()), (self.dof - later.dof) * self.chi2.size)

    def limit(self, scatter: Array) -> ApproachLimit:
        """Return the mean over all points."""
        every = joined(list(self.looks.values()))
        total = float(np.logaddexp.reduce(every.evidence))
        weight = np.exp(every.evidence - total)
        weights = {name: math.exp(float(np.logaddexp.reduce(p.evidence)) - total) for name, p in self.looks.items()}
        mean = weight @ every.values
        off = every.values - mean
        own = weight @ (every.variance + (MODEL_SHARE * every.size) ** 2)
        moving = np.isfinite(every.rate_per_s)
        share = float(weight[moving].sum())
        rate = float(weight[moving] @ every.rate_per_s[moving]) / share if share > _MIN_MOVING_SHARE else math.nan
        covariance = np.diag(own) + (off * weight[:, None]).T @ off
        return ApproachLimit(mean, covariance, weight @ every.left, weights, self.endless, rate, self.windows, scatter)


def _average(stretch: WhitenedMeans) -> _Averaged:
    """Compute every model's posterior for one series."""
    looks = {"none": stretch.standing()}
    for family in ENDING_BENT if stretch.bent else ENDING:
        looks[family.name] = stretch.integrated(family, max(float(p.evidence.max()) for p in looks.values()))
    most = max(float(points.evidence.max()) for points in looks.values())
    endless = float(np.logaddexp.reduce(stretch.integrated(ENDLESS, most).evidence))
    ending = float(np.logaddexp.reduce(joined(list(looks.values())).evidence))
    return _Averaged(looks, 1 / (1 + math.exp(min(ending - endless, 700.0))), len(stretch.edges_s))


def _fits(chi2: float, dof: float) -> bool:
    return chi2 <= dof + _FITS * math.sqrt(2 * max(dof, 0.0))
