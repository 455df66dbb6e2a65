"""Models of an approach to a limit: one rate, two rates, a decaying oscillation, and their posterior on a grid.

For given rates the limits and amplitudes are linear and are integrated analytically. With the flat prior of m∞, the
priors N(0, s²R²) of the amplitudes and the covariance C of the means
    P = Xᵀ C⁻¹ X + diag(0, 1/(sR)², …),     (m∞, a) = P⁻¹ Xᵀ C⁻¹ m ± P⁻¹,
    log p(m | λ) = −½ [mᵀ C⁻¹ m − (m∞, a)ᵀ P (m∞, a)] − ½ log det P − Σ log sR,
summed over the quantities. The rates are integrated over a grid in log λ that is moved, rotated and refined until it
resolves the posterior. Used by daq.signals.limit.
Source: docs/theory/detection_of_steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.decay import decay_means
from daq.signals.normal_equations import solve
from rig_basics.arrays import Array

SLOWEST_PER_S = 0.05  # an approach at a slower rate is a straight line within the windows
FASTEST_PER_S = 4.0
_PRIOR_RANGES = (0.25, 1.0, 4.0)  # prior deviations of a shape's change over the windows, of the data range, each 1/3
_FAINT = (1.0, 0.05, 0.0025)  # prior deviations of the slower of two shapes, of the former, each 1/3: it may be small
_GRID = {1: (40, 21), 2: (17, 13)}  # points along each axis, by dimension: first grid, refined grid
_REACH = 4.5  # standard deviations that a refined grid covers on either side
_MAX_EXPONENT = 200.0
# A noise below this share of the data range is below the rounding of the arithmetic.
_MIN_NOISE_SHARE = 1e-7
# Least prior deviation of a bend, as a share of the data range: it must not be zero.
_MIN_BEND_SHARE = 1e-6
# Share of the normal equations' diagonal that is added to it, so that equal shapes have a solution.
_RIDGE = 1e-13
_MAX_GRIDS, _MIN_GRIDS = 20, 5  # grids per model; grids before a model may be abandoned
_HOPELESS = 40.0  # difference of log evidence to a rival model at which a model is abandoned
_MIN_POINTS = {1: 5.0, 2: 12.0}  # effective number of points, by dimension, at which the grid resolves the posterior


@dataclass(frozen=True)
class Shapes:
    """Decaying shapes for every point of a grid of rates.

    Attributes:
        forms: mean of each shape in each window, shape (g, n, p); p is 0, 1 or 2.
        last: value of each shape at the end of the last window, shape (g, p).
        size: amplitude of an oscillation at that time, shape (g,); None for other shapes.
        rates_per_s: rate of each shape, 1/s, shape (g, p).
        slower_first: True if the first of two shapes is a slower decay of its own.
        square: True if the last shape is the square of the one before it, whose size has a prior.
    """

    forms: Array
    last: Array
    size: Array | None
    rates_per_s: Array
    slower_first: bool = False
    square: bool = False


@dataclass(frozen=True)
class ApproachModel:
    """A model with unknown rates.

    Attributes:
        name: name of the model.
        shapes: function of the windows' edges (n, 2) in s and of the grid points (g, d).
        box: range of each grid coordinate; the prior is uniform in it.
    """

    name: str
    shapes: Callable[[Array, Array], Shapes]
    box: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Points:
    """Result at each point of a grid of rates.

    Attributes:
        evidence: log of marginal likelihood times the point's share of the prior, shape (g,).
        values, variance: posterior of the limits, shapes (g, q).
        left, size: remaining change and its size (amplitude of an oscillation), shapes (g, q).
        rate_per_s: rate of the shape with the largest remaining change, 1/s, shape (g,); NaN if nothing decays.
        chi2: χ² of the residuals, shape (g, q).
        unknowns: number of parameters per quantity, and number shared by all quantities.
    """

    evidence: Array
    values: Array
    variance: Array
    left: Array
    size: Array
    rate_per_s: Array
    chi2: Array
    unknowns: tuple[int, int]


class WhitenedMeans:
    """Consecutive window means, whitened once, so that every model is compared on the same numbers.

    Attributes:
        edges_s: edges of the windows, shape (n, 2), s.
        bent: True if the square of an approach is part of the models.
    """

    def __init__(self, edges_s: Array, means: Array, noise: Array, bends: Array | None = None) -> None:
        """See the arguments of daq.signals.limit; `bends` are those of these windows."""
        self.edges_s: Array = edges_s
        self.bent: bool = bends is not None
        self._origin = np.asarray(means[-1], np.float64)
        values = (means - self._origin).T
        deviation = np.sqrt(np.median(np.diagonal(noise, axis1=1, axis2=2), axis=1))
        self._unit = np.maximum(np.ptp(values, axis=1), deviation)  # unit of all values in this object
        scaled = noise / (self._unit**2)[:, None, None] + _MIN_NOISE_SHARE**2 * np.eye(len(means))
        self._bends = np.zeros(len(values)) if bends is None else np.maximum(bends / self._unit, _MIN_BEND_SHARE)
        self._white = np.asarray(np.linalg.inv(np.linalg.cholesky(scaled)), np.float64)
        self._seen = (self._white @ (values / self._unit[:, None])[:, :, None])[:, :, 0]

    def standing(self) -> Points:
        """Return the result of the model without an approach."""
        n = len(self.edges_s)
        return self.points(Shapes(np.empty((1, n, 0)), np.empty((1, 0)), None, np.empty((1, 0))), 0, 0.0)

    def points(self, shapes: Shapes, rates: int, share: float) -> Points:
        """Integrate limits and amplitudes at each grid point; share: log of a point's share of the prior."""
        count, n, p = shapes.forms.shape
        design = np.concatenate([np.ones((count, n, 1)), shapes.forms], axis=2)
        x = self._white[:, None] @ design  # (q, g, n, 1 + p)
        across = x.transpose(0, 1, 3, 2)
        data = across @ x, (across @ self._seen[:, None, :, None])[..., 0]
        known = np.ones((len(self._seen), p))
        scales = [scale * known for scale in _PRIOR_RANGES] if p else [known]
        if shapes.slower_first:
            scales = [np.column_stack([faint * s[:, 0], s[:, 1:]]) for s in scales for faint in _FAINT]
        if shapes.square:
            scales = [np.column_stack([scale[:, :-1], self._bends]) for scale in scales]
        return joined([self._for_scale(shapes, *data, rates, share - math.log(len(scales)), s) for s in scales])

    def _for_scale(self, shapes: Shapes, across: Array, right: Array, rates: int, share: float, scale: Array) -> Points:
        """As `points` for one prior deviation of each quantity's and shape's change, shape (q, p).

        Args:
            across, right: normal equations of limit and shapes, shapes (q, g, 1 + p, 1 + p), (q, g, 1 + p).
        """
        p = shapes.forms.shape[2]
        prior = np.column_stack([np.zeros(len(scale)), scale**-2])
        fit, variance, log_determinant = solve(
            np.ascontiguousarray(across), np.ascontiguousarray(right), np.ascontiguousarray(prior), _RIDGE
        )
        misfit = (self._seen**2).sum(axis=1)[:, None] - (fit * right).sum(axis=2)
        chi2 = misfit - (fit[..., 1:] ** 2 / scale[:, None] ** 2).sum(axis=2)
        narrowed = log_determinant + 2 * np.log(scale).sum(axis=1)[:, None]
        evidence = -0.5 * (misfit + narrowed).sum(axis=0) + share
        left = -(fit[..., 1:] * shapes.last).sum(axis=2)
        most = np.argmax(np.abs(fit[..., 1:] * shapes.last).sum(axis=0), axis=1) if p else None
        rate = np.full(len(shapes.last), math.nan) if most is None else shapes.rates_per_s[np.arange(len(most)), most]
        size = np.abs(left) if shapes.size is None else np.hypot(fit[..., 1], fit[..., 2]) * shapes.size
        unit = self._unit[:, None]
        return Points(
            evidence,
            (self._origin[:, None] + fit[..., 0] * unit).T,
            (variance * unit**2).T,
            (left * unit).T,
            (size * unit).T,
            rate,
            chi2.T,
            (p if shapes.square else 1 + p, rates),
        )

    def integrated(self, family: ApproachModel, rival: float = -math.inf) -> Points:
        """Return a family's points on a grid that resolves its posterior; a coarse grid if it is far below a rival.

        Args:
            rival: largest evidence of another model's points.
        """
        box = np.array(family.box)
        dimension = len(box)
        first, refined = _GRID[dimension]
        axes, centre = np.diag(0.5 * np.diff(box, axis=1)[:, 0]), box.mean(axis=1)
        steps = (2 * np.arange(first) + 1) / first - 1
        volume = float(np.prod(np.diff(box, axis=1)))
        look = 0
        while True:
            look += 1
            grid = np.stack(np.meshgrid(*[steps] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
            at = centre + grid @ axes.T
            at = at[np.all((at >= box[:, 0]) & (at <= box[:, 1]), axis=1)]
            cell = abs(float(np.linalg.det(axes))) * float(steps[1] - steps[0]) ** dimension
            points = self.points(family.shapes(self.edges_s, at), dimension, math.log(cell / volume))
            weight, heat = _tempered(points.evidence, _MIN_POINTS[dimension])
            hopeless = look >= _MIN_GRIDS and float(points.evidence.max()) < rival - _HOPELESS
            if heat == 1.0 or look == _MAX_GRIDS or hopeless:
                return points
            at = np.tile(at, (len(weight) // len(at), 1))
            centre = weight @ at
            spread = ((at - centre) * weight[:, None]).T @ (at - centre)
            axes = _REACH * np.asarray(
                np.linalg.cholesky(spread + 1e-9 * np.trace(spread) * np.eye(dimension)), np.float64
            )
            steps = np.linspace(-1, 1, refined)


def _tempered(evidence: Array, enough: float) -> tuple[Array, float]:
    """Return the weights, flattened until enough points share them, and the factor by which they were flattened."""
    heat = 1.0
    while True:
        weight = np.exp((evidence - evidence.max()) / heat)
        weight /= weight.sum()
        if 1 / float(weight @ weight) >= min(enough, 0.5 * len(evidence)) or heat > 1e12:
            return weight, heat
        heat *= 2.0


def joined(parts: Sequence[Points]) -> Points:
    """Concatenate grids."""
    if len(parts) == 1:
        return parts[0]
    names = ("evidence", "values", "variance", "left", "size", "rate_per_s", "chi2")
    columns = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    return Points(*columns, unknowns=parts[0].unknowns)


def _max_rate(edges_s: Array) -> float:
    """Rate at which an approach is over long before the last window, 1/s; keeps numbers finite for a slow rotor."""
    return _MAX_EXPONENT / float(edges_s[-1, 1] - edges_s[0, 0])


def _decays(edges_s: Array, rates: Array) -> Shapes:
    """Return the shapes of real rates (g, p), each changing by 1 over the windows."""
    rates = np.minimum(rates, _max_rate(edges_s))
    forms = np.stack([np.real(decay_means(column, edges_s)) for column in rates.T], axis=2)
    change = np.abs(forms[:, 0] - forms[:, -1])
    return Shapes(forms / change[:, None], 1 / change, None, rates)


def _one(edges_s: Array, at: Array) -> Shapes:
    return _decays(edges_s, np.exp(at))


def _two(edges_s: Array, at: Array) -> Shapes:
    shapes = _decays(edges_s, np.minimum(np.exp(np.cumsum(at, axis=1)), 1.5 * FASTEST_PER_S))
    return replace(shapes, slower_first=True)


def _bent(shapes: Callable[[Array, Array], Shapes]) -> Callable[[Array, Array], Shapes]:
    """Return the same shapes and the square of the last one."""

    def with_square(edges_s: Array, at: Array) -> Shapes:
        plain = shapes(edges_s, at)
        rates = np.concatenate([plain.rates_per_s, 2 * plain.rates_per_s[:, -1:]], axis=1)
        return replace(_decays(edges_s, rates), slower_first=plain.slower_first, square=True)

    return with_square


def _wave(edges_s: Array, at: Array) -> Shapes:
    rate, turn = np.exp(at).T
    rate = np.minimum(rate, _max_rate(edges_s))
    turning = decay_means(rate - 1j * turn, edges_s)
    size = 1 / np.abs(turning).max(axis=1)
    forms = np.stack([np.real(turning), np.imag(turning)], axis=2) * size[:, None, None]
    return Shapes(forms, np.stack([size, np.zeros(len(size))], axis=1), size, np.stack([rate, rate], axis=1))


def _no_end(edges_s: Array, at: Array) -> Shapes:
    shapes = _decays(edges_s, np.where(np.abs(at) < 1e-4, 1e-4, at))
    return Shapes(shapes.forms - shapes.forms[:, -1:], shapes.last, None, shapes.rates_per_s)


_RATES = (math.log(SLOWEST_PER_S), math.log(FASTEST_PER_S))
_SLOW = (math.log(SLOWEST_PER_S), math.log(2.0))
_TWO = (_SLOW, (math.log(1.8), math.log(15.0)))
_SWING = ApproachModel("oscillation", _wave, (_SLOW, (math.log(0.15), math.log(2.8))))
ENDING = (ApproachModel("one rate", _one, (_RATES,)), ApproachModel("two rates", _two, _TWO), _SWING)
ENDING_BENT = (ApproachModel("one rate", _bent(_one), (_RATES,)), ApproachModel("two rates", _bent(_two), _TWO), _SWING)
ENDLESS = ApproachModel("endless", _no_end, ((-1.0, 0.6 * SLOWEST_PER_S),))  # straight lines and growth
