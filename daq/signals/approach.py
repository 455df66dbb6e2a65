# pyright: strict
"""What is still to come of an approach to rest, as a bound, from window means that are known only to ± a width.

A mean m_k of a window is known to lie within w of the truth: w holds half a count of a code that stands still (less
where noise or a wobble dithers it) and the noise of the mean. An approach m∞ + a e^{−λ(t−T)}, T the end of the last
window, fits when every two windows j, k agree: |m_j − m_k − a (u_j − u_k)| ≤ 2w with u the window's mean of
e^{−λ(t−T)}. That leaves for each rate λ an interval of a, the change still to come, and the bound is the largest |a|
of all rates that fit. Where the means do not move beyond ± w every rate fits; then only the time for which they have
stood says something, and rates below a slowest one are left out. Where they move, slower decays count as well, and a
drift that fits growth or a straight line, and none that ends soon enough, has no bound.

The longest stretch that some rate fits is taken, so that the rate is known from all that was seen of it. Where no
stretch fits, two rates together and decaying oscillations are tried, then the whole range of the newest means is
taken for a change at the slowest rate.
Source: docs/theory/steady_states.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOWEST_PER_S = 0.08  # slower than this a radian would not shrink to the tolerance in a minute and a half
_ENDLESS_PER_S = 0.01  # so slow that over the windows it is a straight line
_SHOWS = 4.0  # widths: means that move less say nothing of a rate
_SLOWER_BY = 3.0  # exponent: twice that, and the slowest rate that counts falls from SLOWEST_PER_S to _ENDLESS_PER_S
_FAST_PER_S = 0.5  # an approach this fast hides a slow one beside it until it is over
_STEP = 1.06  # from one rate that is tried to the next
_BETWEEN = 1.15  # on the bound of a drift: for the rates between those that are tried
_FASTEST_PER_S = 4.0
_LEAST_WINDOWS = 9
_MARGIN = 1.5  # on the width for a drift that ends: the rates that are tried are not all there are
_RIDGE = 1e-9  # keeps two nearly equal shapes apart
_SHORTER = 0.7  # of the windows are kept when nothing fits all
_NOT_QUITE = 0.01  # of the newest windows' range: an approach is exponential only near its end, and rates are a grid
_CLEARLY = 0.1  # of the newest windows' range: two rates or an oscillation count as found when they leave less


@dataclass(frozen=True)
class Approach:
    """What is still to come after the last window.

    Attributes:
        remaining: bound on the change still to come, unit of the means; inf for a drift that need not end.
        mean_off: bound on the distance from the end of the mean over the stretch asked for.
        rate_per_s: rate of the approach that gives the bound; 0 where it need not end.
        seen_s: length of the stretch the bound rests on.
    """

    remaining: float
    mean_off: float
    rate_per_s: float
    seen_s: float


def bound(edges_s: Array, means: Array, width: float, average_s: float, far: float = math.inf) -> Approach:
    """Bound on what is still to come of one quantity.

    Args:
        edges_s: start and end of each window, shape (n, 2), in order, n ≥ 3.
        means: the quantity's mean in each, shape (n,).
        width: how far a mean may be from the truth.
        average_s: length of the stretch before the last window's end whose mean's distance from the end is asked.
        far: a change over the last two windows from which on a crude bound will do.
    """
    late = slice(-_LEAST_WINDOWS, None)
    width = max(width, _NOT_QUITE * float(np.ptp(means[late])))
    tails = _tails(len(means))
    for count in tails:
        found = _one_rate(edges_s[-count:], means[-count:], width, average_s)
        if found is not None:
            return found
    for count in tails if np.ptp(means[-3:]) < far else ():
        found = _two_terms(edges_s[-count:], means[-count:], width, _CLEARLY * float(np.ptp(means[late])), average_s)
        if found is not None:
            return found
    return _unexplained(edges_s[late], means[late], width, average_s)


def _unexplained(edges_s: Array, means: Array, width: float, average_s: float) -> Approach:
    """No approach fits: the means may come as far again as the slowest approach would from their whole range.

    No bound where they move one way and no slower than before.
    """
    seen = float(edges_s[-1, 1] - edges_s[0, 0])
    half = len(means) // 2
    before, now = np.ptp(means[: half + 1]), np.ptp(means[half:])
    if now >= before and abs(means[-1] - means[half]) > max(0.8 * now, 4 * width):
        return Approach(math.inf, math.inf, 0.0, seen)
    between = float(edges_s[-1].mean() - edges_s[0].mean())
    left = (float(np.ptp(means)) + 2 * width) / math.expm1(SLOWEST_PER_S * between)
    return Approach(left, left * float(_of_mean(SLOWEST_PER_S, average_s)), SLOWEST_PER_S, seen)


def _tails(count: int) -> list[int]:
    """How many of the newest windows to look at, most first."""
    tails = [count]
    while tails[-1] > _LEAST_WINDOWS:
        tails.append(max(_LEAST_WINDOWS, int(tails[-1] * _SHORTER)))
    return tails


@lru_cache(maxsize=1)
def _rates() -> Array:
    """Rates that are tried, 1/s: growth, a straight line (nearly) and decay; shape (r,)."""
    decay = _ENDLESS_PER_S * _STEP ** np.arange(math.ceil(math.log(_FASTEST_PER_S / _ENDLESS_PER_S) / math.log(_STEP)))
    return np.concatenate([-decay[::2], [1e-4], decay])


def _shape(rates: NDArray[Any], edges_s: Array) -> NDArray[Any]:
    """Mean of e^{−λ(t−T)} in each window, shape (rates, windows); a complex λ turns."""
    middle = edges_s.mean(axis=1) - edges_s[-1, 1]
    half = 0.5 * np.diff(edges_s, axis=1)[:, 0]
    x = rates[:, None] * half
    return np.exp(-rates[:, None] * middle) * np.sinh(x) / x


@lru_cache(maxsize=8)  # the two quantities of one look share their windows
def _spans(edges: bytes) -> tuple[Array, Array]:
    """1/(u_j − u_k) of every two windows j < k for every rate, and its modulus; shape (rates, couples).

    Args:
        edges: the bytes of the windows' edges, shape (n, 2), s.
    """
    shape = _shape(_rates(), np.frombuffer(edges).reshape(-1, 2))
    early, late = np.triu_indices(shape.shape[1], 1)
    with np.errstate(over="ignore", divide="ignore"):
        inverse = 1 / (shape[:, early] - shape[:, late])
    return inverse, np.abs(inverse)


def _of_mean(rates: Array | float, average_s: float) -> Array:
    """Mean of e^{−λ(t−T)} over the last stretch."""
    x = np.maximum(np.asarray(rates), 1e-6) * average_s
    return np.expm1(x) / x


def _one_rate(edges_s: Array, means: Array, width: float, average_s: float) -> Approach | None:
    """The largest change still to come of all single rates that fit; None when none fits."""
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
    if np.any(fits & ending):  # growth is found where nothing that ends fits as well
        fits &= rates >= _slowest(spread / width)
    elif np.any(fits & (rates <= _ENDLESS_PER_S)):
        return Approach(math.inf, math.inf, 0.0, seen)
    left = np.where(fits, np.maximum(np.abs(low), np.abs(high)), 0.0) * (_BETWEEN if moves else 1.0)
    worst = int(np.argmax(left))
    found = Approach(float(left[worst]), float(np.max(left * _of_mean(rates, average_s))), float(rates[worst]), seen)
    return _with_slow(found, float(rates[fits].min()), edges_s, means, width, average_s)


def _slowest(widths: float) -> float:
    """Slowest decay that counts where the means move by so many widths, 1/s: a noisy mean more or less is no jump."""
    slower = (max(widths, _SHOWS) / _SHOWS) ** _SLOWER_BY
    return max(_ENDLESS_PER_S, SLOWEST_PER_S / slower)


def _with_slow(
    found: Approach, slowest: float, edges_s: Array, means: Array, width: float, average_s: float
) -> Approach:
    """The bound, or that of a slow approach hidden beside it where all that fits is fast."""
    slow = _beside(edges_s, means, width) if slowest > _FAST_PER_S else 0.0
    if slow <= found.remaining:
        return found
    return Approach(slow, slow * float(_of_mean(SLOWEST_PER_S, average_s)), SLOWEST_PER_S, found.seen_s)


def _beside(edges_s: Array, means: Array, width: float) -> float:
    """What a slow approach beside a fast one may have to go: known by how long the means have stood since."""
    after = np.maximum.accumulate(means[::-1]) - np.minimum.accumulate(means[::-1]) <= 2 * width
    standing = int(np.argmin(after)) if not after.all() else len(means)
    stood = float(edges_s[-1].mean() - edges_s[-standing].mean())
    most = _unexplained(edges_s[-_LEAST_WINDOWS:], means[-_LEAST_WINDOWS:], width, 1.0).remaining
    return min(most, 2 * width / math.expm1(SLOWEST_PER_S * stood)) if standing > 1 else most


@lru_cache(maxsize=1)
def _terms() -> tuple[Array, Array]:
    """Rates of two terms, 1/s: pairs (λ1, λ2) well apart, shape (p, 2), and (λ, ω) of oscillations, shape (q, 2)."""
    slow = np.geomspace(SLOWEST_PER_S, 1.0, 9)
    pairs = [(a, b) for a in slow for b in np.geomspace(0.25, _FASTEST_PER_S, 9) if b > 2.5 * a]
    decay = np.concatenate([[-0.1, 1e-4, 0.03], np.geomspace(SLOWEST_PER_S, 2.0, 9)])
    waves = [(a, w) for a in decay for w in np.geomspace(0.25, 2.8, 14)]
    return np.array(pairs), np.array(waves)


@lru_cache(maxsize=8)  # the two quantities of one look share their windows
def _designs(edges: bytes) -> tuple[Array, Array]:
    """For each two terms 1 and their two shapes, (h, n, 3), and the least squares inverse of that, (h, 3, n).

    Args:
        edges: the bytes of the windows' edges, shape (n, 2), s.
    """
    edges_s = np.frombuffer(edges).reshape(-1, 2)
    pairs, waves = _terms()
    turning = _shape(waves[:, 0] - 1j * waves[:, 1], edges_s)
    shapes = np.concatenate(
        [
            np.stack([_shape(pairs[:, 0], edges_s), _shape(pairs[:, 1], edges_s)], axis=2),
            np.stack([np.real(turning), np.imag(turning)], axis=2),
        ]
    )
    design = np.concatenate([np.ones((*shapes.shape[:2], 1)), shapes], axis=2)
    scale = np.abs(design).max(axis=1, keepdims=True)
    scaled = design / scale
    across = scaled.transpose(0, 2, 1)
    inverse = _solved(across @ scaled + _RIDGE * np.eye(3), across) / scale.transpose(0, 2, 1)
    return design, inverse


def _solved(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right), np.float64)


def _two_terms(edges_s: Array, means: Array, width: float, most: float, average_s: float) -> Approach | None:
    """Two rates, or a decaying oscillation, fitted by least squares; None when none leaves less than `most`.

    Two terms of a pair may cancel now and not later, so their sizes are added.
    """
    pairs, waves = _terms()
    design, inverse = _designs(edges_s.tobytes())
    found = np.asarray(inverse @ means, np.float64)
    rest = np.abs(means - (design @ found[:, :, None])[:, :, 0]).max(axis=1)
    width = max(width, 1.5 * float(rest.min()))
    if width > most:
        return None
    fits = rest <= width
    size = np.abs(found[:, 1:]) + width * np.abs(inverse[:, 1:]).sum(axis=2)
    rates = np.concatenate([pairs[:, 0], waves[:, 0]])
    fast = np.concatenate([pairs[:, 1], waves[:, 0]])
    wave = np.arange(len(rates)) >= len(pairs)
    swing = np.hypot(size[:, 0], size[:, 1]) * np.where(rates < _ENDLESS_PER_S, 2.0, 1.0)  # one that lasts: both ways
    left = size[:, 0] + size[:, 1]
    left[wave] = swing[wave]
    off: Array = size[:, 0] * _of_mean(rates, average_s) + size[:, 1] * _of_mean(fast, average_s)
    left[~fits] = 0.0
    off = np.where(fits, np.maximum(off, left), 0.0)
    worst = int(np.argmax(left))
    seen = float(edges_s[-1, 1] - edges_s[0, 0])
    result = Approach(float(left[worst]), float(off.max()), max(0.0, float(rates[worst])), seen)
    return _with_slow(result, float(rates[fits].min()), edges_s, means, width, average_s)
