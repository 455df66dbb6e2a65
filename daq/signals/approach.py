"""Bound on the remaining change of a quantity that approaches its end, from window means with an error of at most ± w.

The mean m_k of a window is within w of the true mean. The width w contains the noise of the mean and half a count of a
constant code (less if noise or a ripple dithers the code). An approach m∞ + a e^{−λ(t−T)}, with T the end of the last
window, fits if every pair of windows j, k agrees: |m_j − m_k − a (u_j − u_k)| ≤ 2w, where u is the window mean of
e^{−λ(t−T)}. For each rate λ this leaves an interval of a, the remaining change. The bound is the largest |a| over all
rates that fit. If the means stay within ± w, every rate fits. Then only the time for which they were constant gives
information, and rates below the slowest one are excluded. If the means move, slower decays are included as well. A
drift that fits growth or a straight line, and no approach that ends soon enough, has no bound.

The longest series of newest windows that some rate fits is used, so that the rate is estimated from as many windows as
possible. For this a width below 1 % of the newest windows' range counts as 1 %, because approaches are only nearly
exponential. A mixture of two rates also fits one rate within 1 % of a large movement, and its slow part can leave far
more than that rate would. Therefore two rates together and decaying oscillations are fitted as well, also to a longer
series that they fit closely, unless one rate explains the means within ± w or the newest means move by less than 10 w,
and the larger bound is valid. If neither fits, the whole range of the newest means is taken as a change at the slowest
rate.
Source: docs/theory/detection_of_steady_states.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from daq.signals.decay import MIN_WINDOWS, decay_means, newest_counts
from rig_basics.arrays import Array

SLOWEST_PER_S = 0.08  # at a slower rate one radian would not decay to the tolerance within a minute and a half
_ENDLESS_PER_S = 0.01  # so slow that it is a straight line over the windows
_MIN_MOTION_WIDTHS = 4.0  # means that move by less give no information on the rate
_SLOWER_BY = 3.0  # exponent: twice _MIN_MOTION_WIDTHS lowers the slowest included rate from SLOWEST to _ENDLESS_PER_S
_FAST_PER_S = 0.5  # an approach this fast hides a simultaneous slow one until it is over
_STEP = 1.06  # ratio of neighbouring trial rates
# The bound of a drift is larger by this factor, because the true rate may lie between two trial rates.
_GRID_FACTOR = 1.15
_FASTEST_PER_S = 4.0
_SLOWEST_SINGLE_PER_S = 0.05
# The width is larger by this factor for a drift that ends, because its rate may lie between two trial rates.
_MARGIN = 1.5
# Times the least residual of two terms: other trial rates that may be the true ones. Fewer if no single rate fits: the
# least residual is then that of the nearest shape.
_RESIDUALS, _FEW_RESIDUALS = 3.0, 1.5
_CLOSE = 1.5  # widths: residual up to which two terms continue beyond the windows that one rate fits
_FAINT = 10.0  # widths: of means that move by less, two rates would describe the noise
_RIDGE = 1e-9  # regularises two nearly equal shapes
# Least width as a share of the newest windows' range: approaches are only nearly exponential, and rates are a grid.
_MIN_WIDTH_SHARE = 0.01
# Two rates or an oscillation are accepted up to this residual, as a share of the newest windows' range.
_MAX_RESIDUAL_SHARE = 0.1


@dataclass(frozen=True)
class Approach:
    """Remaining change after the last window.

    Attributes:
        remaining: bound on the remaining change, unit of the means; inf for a drift that need not end.
        mean_off: bound on the distance of the mean over the last `average_s` from the end value.
        rate_per_s: rate of the approach that gives the bound, 1/s; 0 for a drift that need not end.
        seen_s: length of the series of windows that gives the bound, s.
    """

    remaining: float
    mean_off: float
    rate_per_s: float
    seen_s: float


def bound(edges_s: Array, means: Array, width: float, average_s: float, far: float = math.inf) -> Approach:
    """Return a bound on the remaining change of one quantity.

    Args:
        edges_s: start and end of each window, shape (n, 2), s, in order, n ≥ 3.
        means: mean of the quantity in each window, shape (n,).
        width: largest error of a mean.
        average_s: length of the period before the last window's end over which `mean_off` is computed, s.
        far: change over the last two windows above which a crude bound is sufficient.
    """
    newest = float(np.ptp(means[-MIN_WINDOWS:]))
    wide = max(width, _MIN_WIDTH_SHARE * newest)
    tails = newest_counts(len(means))
    fits = ((count, _one_rate(edges_s[-count:], means[-count:], wide, average_s)) for count in tails)
    longest, one = next(((count, found) for count, found in fits if found is not None), (len(means), None))
    near = float(np.ptp(means[-3:])) < far and (one is None or math.isfinite(one.remaining))
    if not near:
        return one or _unexplained(edges_s[-MIN_WINDOWS:], means[-MIN_WINDOWS:], wide, average_s)
    for count in tails:
        since = -min(count, longest)
        if one is not None and (newest < _FAINT * width or _misfit(edges_s[since:], means[since:]) <= width):
            return one
        if count > longest:
            fit, most = (width, _RESIDUALS), _CLOSE * _RESIDUALS * width
        else:
            fit = (wide, _FEW_RESIDUALS) if one is None else (width, _RESIDUALS)
            most = max(width, _MAX_RESIDUAL_SHARE * newest)
        two = _two_terms(edges_s[-count:], means[-count:], *fit, most, average_s)
        if two is not None:
            return _larger(one, two)
    return one or _unexplained(edges_s[-MIN_WINDOWS:], means[-MIN_WINDOWS:], wide, average_s)


def _larger(one: Approach | None, two: Approach) -> Approach:
    """Return the approach that leaves more, with the larger `mean_off`."""
    if one is None:
        return two
    worst = max(one, two, key=lambda each: each.remaining)
    return replace(worst, mean_off=max(one.mean_off, two.mean_off))


def _misfit(edges_s: Array, means: Array) -> float:
    """Return the largest residual of the best single rate: 0 for means that do not move."""
    with np.errstate(over="ignore", invalid="ignore"):  # fast rates over long windows
        shape = decay_means(_single_rates(), edges_s)
        shape -= shape.mean(axis=1, keepdims=True)
        centred = means - means.mean()
        size = (shape @ centred) / (shape**2).sum(axis=1)
        residual = np.abs(centred - size[:, None] * shape).max(axis=1)
    return float(np.where(np.isnan(residual), np.inf, residual).min())


@lru_cache(maxsize=1)
def _single_rates() -> Array:
    """Trial rates of a single decay, 1/s: so near each other that the step between them does not count."""
    return np.geomspace(_SLOWEST_SINGLE_PER_S, _FASTEST_PER_S, 400)


def _unexplained(edges_s: Array, means: Array, width: float, average_s: float) -> Approach:
    """Return the bound if no approach fits: as much as the slowest approach would still move, given the whole range.

    The result is unbounded if the means move in one direction and not more slowly than before.
    """
    seen = float(edges_s[-1, 1] - edges_s[0, 0])
    half = len(means) // 2
    before, now = np.ptp(means[: half + 1]), np.ptp(means[half:])
    if now >= before and abs(means[-1] - means[half]) > max(0.8 * now, 4 * width):
        return Approach(math.inf, math.inf, 0.0, seen)
    between = float(edges_s[-1].mean() - edges_s[0].mean())
    left = (float(np.ptp(means)) + 2 * width) / math.expm1(SLOWEST_PER_S * between)
    return Approach(left, left * float(_of_mean(SLOWEST_PER_S, average_s)), SLOWEST_PER_S, seen)


@lru_cache(maxsize=1)
def _rates() -> Array:
    """Trial rates, 1/s: growth, a straight line (nearly) and decay; shape (r,)."""
    decay = _ENDLESS_PER_S * _STEP ** np.arange(math.ceil(math.log(_FASTEST_PER_S / _ENDLESS_PER_S) / math.log(_STEP)))
    return np.concatenate([-decay[::2], [1e-4], decay])


@lru_cache(maxsize=8)  # both quantities of one evaluation share their windows
def _spans(edges: bytes) -> tuple[Array, Array]:
    """1/(u_j − u_k) of every pair of windows j < k for every rate, and its modulus; shape (rates, pairs).

    Args:
        edges: the bytes of the windows' edges, shape (n, 2), s.
    """
    shape = decay_means(_rates(), np.frombuffer(edges).reshape(-1, 2))
    early, late = np.triu_indices(shape.shape[1], 1)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        inverse = 1 / (shape[:, early] - shape[:, late])
    return inverse, np.abs(inverse)


def _of_mean(rates: Array | float, average_s: float) -> Array:
    """Mean of e^{−λ(t−T)} over the last `average_s`."""
    x = np.maximum(np.asarray(rates), 1e-6) * average_s
    return np.expm1(x) / x


def _one_rate(edges_s: Array, means: Array, width: float, average_s: float) -> Approach | None:
    """Return the largest remaining change over all single rates that fit; None if none fits."""
    seen = float(edges_s[-1, 1] - edges_s[0, 0])
    spread = float(np.ptp(means))
    moves = spread > 2 * width * (1 + 1e-9)
    rates = _rates()
    if not moves:
        rates = rates[rates >= SLOWEST_PER_S]
    ending = rates >= SLOWEST_PER_S
    widths = width * np.where(ending & moves, _MARGIN, 1.0)[:, None]
    early, late = np.triu_indices(len(means), 1)
    inverse, size = (table[-len(rates) :] for table in _spans(edges_s.tobytes()))
    with np.errstate(over="ignore", invalid="ignore"):
        middle, half = (means[early] - means[late]) * inverse, 2 * widths * size
        low, high = (middle - half).max(axis=1), (middle + half).min(axis=1)
    fits = low <= high
    if not fits.any():
        return None
    if np.any(fits & ending):  # growth is accepted only if no approach that ends fits as well
        fits &= rates >= _slowest(spread / width)
    elif np.any(fits & (rates <= _ENDLESS_PER_S)):
        return Approach(math.inf, math.inf, 0.0, seen)
    left = np.where(fits, np.maximum(np.abs(low), np.abs(high)), 0.0) * (_GRID_FACTOR if moves else 1.0)
    worst = int(np.argmax(left))
    found = Approach(float(left[worst]), float(np.max(left * _of_mean(rates, average_s))), float(rates[worst]), seen)
    return _with_slow(found, float(rates[fits].min()), edges_s, means, width, average_s)


def _slowest(widths: float) -> float:
    """Slowest included decay for means that move by `widths`, 1/s: continuous, so that a little noise makes no jump."""
    slower = (max(widths, _MIN_MOTION_WIDTHS) / _MIN_MOTION_WIDTHS) ** _SLOWER_BY
    return max(_ENDLESS_PER_S, SLOWEST_PER_S / slower)


def _with_slow(
    found: Approach, slowest: float, edges_s: Array, means: Array, width: float, average_s: float
) -> Approach:
    """Return the bound, or that of a hidden slow approach if only fast rates fit and the latter is larger."""
    slow = _hidden_slow(edges_s, means, width) if slowest > _FAST_PER_S else 0.0
    if slow <= found.remaining:
        return found
    return Approach(slow, slow * float(_of_mean(SLOWEST_PER_S, average_s)), SLOWEST_PER_S, found.seen_s)


def _hidden_slow(edges_s: Array, means: Array, width: float) -> float:
    """Remaining change of a slow approach hidden by a fast one: limited by the time the means have been constant."""
    after = np.maximum.accumulate(means[::-1]) - np.minimum.accumulate(means[::-1]) <= 2 * width
    standing = int(np.argmin(after)) if not after.all() else len(means)
    stood = float(edges_s[-1].mean() - edges_s[-standing].mean())
    most = _unexplained(edges_s[-MIN_WINDOWS:], means[-MIN_WINDOWS:], width, 1.0).remaining
    return min(most, 2 * width / math.expm1(SLOWEST_PER_S * stood)) if standing > 1 else most


@lru_cache(maxsize=1)
def _terms() -> tuple[Array, Array]:
    """Rates of two terms, 1/s: different pairs (λ1, λ2), shape (p, 2), and (λ, ω) of oscillations, shape (q, 2)."""
    slow = np.geomspace(SLOWEST_PER_S, 2.2, 30)
    pairs = [(a, b) for a in slow for b in np.geomspace(0.1, _FASTEST_PER_S, 64) if b > 1.25 * a]
    decay = np.concatenate([[-0.1, 1e-4, 0.03], np.geomspace(SLOWEST_PER_S, 2.0, 9)])
    waves = [(a, w) for a in decay for w in np.geomspace(0.25, 2.8, 14)]
    return np.array(pairs), np.array(waves)


@lru_cache(maxsize=8)  # both quantities of one evaluation share their windows
def _designs(edges: bytes) -> tuple[Array, Array]:
    """Design matrix of each two-term model, 1 and its two shapes, (h, n, 3), and its least-squares inverse, (h, 3, n).

    Args:
        edges: the bytes of the windows' edges, shape (n, 2), s.
    """
    edges_s = np.frombuffer(edges).reshape(-1, 2)
    pairs, waves = _terms()
    turning = decay_means(waves[:, 0] - 1j * waves[:, 1], edges_s)
    shapes = np.concatenate(
        [
            np.stack([decay_means(pairs[:, 0], edges_s), decay_means(pairs[:, 1], edges_s)], axis=2),
            np.stack([np.real(turning), np.imag(turning)], axis=2),
        ]
    )
    design = np.concatenate([np.ones((*shapes.shape[:2], 1)), shapes], axis=2)
    with np.errstate(over="ignore", invalid="ignore"):  # fast rates over long windows
        scale = np.abs(design).max(axis=1, keepdims=True)
        scaled = design / scale
        across = scaled.transpose(0, 2, 1)
        inverse = _solved(across @ scaled + _RIDGE * np.eye(3), across) / scale.transpose(0, 2, 1)
    return design, inverse


def _solved(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right), np.float64)


def _two_terms(
    edges_s: Array, means: Array, width: float, residuals: float, most: float, average_s: float
) -> Approach | None:
    """Fit two rates, or a decaying oscillation, by least squares; None if every fit leaves more than `most`.

    The two terms of a pair may cancel now and not later. Therefore their absolute values are added.

    Args:
        residuals: least residual of all fits to that of a fit that counts.
    """
    pairs, waves = _terms()
    design, inverse = _designs(edges_s.tobytes())
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.asarray(inverse @ means, np.float64)
        residual = np.abs(means - (design @ found[:, :, None])[:, :, 0]).max(axis=1)
    residual[np.isnan(residual)] = np.inf  # fast rates over long windows: no shape, so no fit
    width = max(width, residuals * float(residual.min()))
    if width > most:
        return None
    fits = residual <= width
    size = np.abs(found[:, 1:]) + width * np.abs(inverse[:, 1:]).sum(axis=2)
    rates = np.concatenate([pairs[:, 0], waves[:, 0]])
    fast = np.concatenate([pairs[:, 1], waves[:, 0]])
    wave = np.arange(len(rates)) >= len(pairs)
    swing = np.hypot(size[:, 0], size[:, 1]) * np.where(
        rates < _ENDLESS_PER_S, 2.0, 1.0
    )  # an undamped one moves to both sides
    left = size[:, 0] + size[:, 1]
    left[wave] = swing[wave]
    off: Array = size[:, 0] * _of_mean(rates, average_s) + size[:, 1] * _of_mean(fast, average_s)
    left[~fits] = 0.0
    off = np.where(fits, np.maximum(off, left), 0.0)
    worst = int(np.argmax(left))
    rate = float(rates[worst] if size[worst, 0] > size[worst, 1] else fast[worst])
    seen = float(edges_s[-1, 1] - edges_s[0, 0])
    result = Approach(float(left[worst]), float(off.max()), max(0.0, rate), seen)
    return _with_slow(result, float(rates[fits].min()), edges_s, means, width, average_s)
