"""Order envelopes that change with time: Vold–Kalman filtering with bandwidths estimated from the data.

A signal is o(t) + Σ_k Re A_k(t) e^{ikψ(t)} + noise. Each envelope is a cubic spline with a knot every h seconds, whose
third differences have a normal distribution of unknown variance. This is the structural equation of Vold and Leuridan
with the data equation in its exact form, for all orders together. The variances (the bandwidths of the filters) and
that of the noise maximise the restricted likelihood (Fellner–Schall steps), so that no bandwidth has to be chosen. The
posterior covariance of the envelopes is their uncertainty. Derivation: docs/theory/order_tracking.md.

The samples enter only through the moments Σ u^p e^{ijψ} of each knot interval. The normal equations of any number of
iterations follow from these and are banded, as is the required part of their inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
import scipy
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from rig_basics.arrays import Array

_BASIS = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6.0
"""Cubic B-splines by powers of u within one interval: row a is the spline that began 3 − a intervals before it."""
_PENALTY = np.array([-1.0, 3.0, -3.0, 1.0])
_MAX_STEPS = 40
_MAX_LOG_CHANGE = 0.1  # of a weight at convergence
_MAX_STIFFNESS = 1e7  # weight of a third difference over that of the data
_RESOLVED = 300.0  # weight over that of the data above which the knots are dense enough
_ROUGHNESS_KNOTS = 8.0  # width of the average of the roughness


@dataclass(frozen=True)
class Envelopes:
    """Envelopes of one signal, by knots.

    Attributes:
        start_s, knot_s: first knot and distance between knots, s.
        coefficients: spline coefficients, shape (knots + 3, 1 + 2 K): offset, then real and imaginary part of each
            order.
        blocks: covariance of the coefficients of four neighbouring splines, shape (knots, 4 m, 4 m), m = 1 + 2 K.
        noise: standard deviation of one sample.
        freedom: effective degrees of freedom of the offset and of each order, shape (1 + K,).
        roughness: roughness of each coefficient's envelope about each knot over its mean roughness, shape (m, knots).
    """

    start_s: float
    knot_s: float
    coefficients: Array
    blocks: Array
    noise: float
    freedom: Array
    roughness: Array

    def values_at(self, time_s: Array) -> Array:
        """Return offset, then real and imaginary part of each order at times, shape (n, m)."""
        interval, weights = self._place(time_s)
        out = weights[:, :1] * self.coefficients[interval]
        for a in range(1, 4):
            out += weights[:, a : a + 1] * self.coefficients[interval + a]
        return out

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return values at times and their variances, shapes (n, m).

        On average 5/6 of a posterior variance is noise that passes the filter and 1/6 is the part of the envelope that
        the filter removes (theory/order_tracking.md). The latter is scaled with the envelope's roughness at the time.
        """
        interval, weights = self._place(time_s)
        m = self.coefficients.shape[1]
        blocks = self.blocks[interval].reshape(-1, 4, m, 4, m)
        variance = np.einsum("na,namcm,nc->nm", weights, blocks, weights)
        return self.values_at(time_s), np.maximum(variance, 0.0) * (5.0 + self.roughness[:, interval].T) / 6.0

    def residuals(self, time_s: Array, signal: Array, phase_rad: Array) -> Array:
        """Return the samples minus the envelopes' signal, shape (n,)."""
        return _residuals(time_s, signal, phase_rad, self.start_s, self.knot_s, self.coefficients)

    def _place(self, time_s: Array) -> tuple[NDArray[np.int64], Array]:
        place = (np.asarray(time_s) - self.start_s) / self.knot_s
        interval = np.clip(place.astype(np.int64), 0, len(self.blocks) - 1)
        return interval, np.vander(place - interval, 4, increasing=True) @ _BASIS.T


def fit_envelopes(
    time_s: Array,
    signal: Array,
    phase_rad: Array,
    orders: int,
    knot_s: float,
    widths: Array,
    *,
    least_noise: float = 0.0,
) -> Envelopes:
    """Fit the envelopes of the offset and of orders 1 … `orders`.

    Args:
        time_s, signal, phase_rad: finite samples in order of time, shapes (n,); s, any unit, rad.
        orders: highest order.
        knot_s: requested distance between knots, s.
        widths: greatest filter width of the offset and of each order, in orders, shape (1 + `orders`,).
        least_noise: lower bound of one sample's standard deviation, if noise near the orders is known to be larger.
    Raises:
        ValueError: the samples do not separate the orders.
    """
    duration = float(time_s[-1] - time_s[0])
    scale, middle = float(np.std(signal)) or 1.0, float(np.mean(signal))
    normalised = (signal - middle) / scale
    m = 1 + 2 * orders
    begin: Array | None = None
    found_step = 1.0
    for finer in (25, 5, 1):  # a coarse grid finds the bandwidths at low cost, and may be fine enough
        knots = max(8, math.ceil(duration / (finer * knot_s)))
        step = duration / knots * (1 + 1e-12)
        phasors, products = _moments(time_s, normalised, phase_rad, float(time_s[0]), step, knots, orders)
        equations = NormalEquations(
            *_normal_equations(phasors, products, orders),
            float(normalised @ normalised),
            len(signal),
            (least_noise / scale) ** 2,
        )
        passed = cast("Array", np.interp(time_s[0] + step * np.arange(knots + 1), time_s, phase_rad))
        turns = np.abs(np.diff(passed)) / (2 * np.pi)
        least = np.stack([_least_weights(turns, width) for width in widths])
        if begin is not None:
            begin = begin * (found_step / step) ** 5
        found, begin, resolved = _restricted_likelihood(equations, least, m, begin)
        found_step = step
        if resolved:
            break
    coefficients = found.coefficients.reshape(knots + 3, m) * scale
    coefficients[:, 0] += middle
    blocks = _blocks(found.inverse, knots, m) * found.variance * scale**2
    roughness = np.repeat(_roughness(found.free, found.taken), [1] + [2] * orders, axis=0)
    noise = scale * math.sqrt(found.variance)
    return Envelopes(float(time_s[0]), step, coefficients, blocks, noise, found.freedom, roughness)


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations: lower band of XᵀX by columns (N, 4 m), Xᵀx (N,), xᵀx, number of samples, least variance."""

    gram: Array
    right: Array
    total: float
    samples: int
    least_variance: float


@dataclass(frozen=True)
class _Posterior:
    """Envelopes at given weights: coefficients, the band of their covariance, and the terms of the next weights.

    Attributes:
        freedom: effective degrees of freedom of each part.
        free, taken: for each part and knot, the degrees of freedom of its third difference determined by the data, and
            its square over its prior variance; their sums are equal where the restricted likelihood is largest.
    """

    coefficients: Array
    inverse: Array
    variance: float
    freedom: Array
    free: Array
    taken: Array


def _least_weights(turns: Array, width: float) -> Array:
    """Return the least weight of each third difference over that of the data: it limits the filter's width.

    A filter must end at 0.4 of the rotor's frequency. Beyond half of it an envelope could be one of the next order, or
    the offset.

    Args:
        turns: turns of the rotor between knots, shape (n,).
        width: greatest width of the filter, in orders.
    """
    edge = 2 * np.sin(np.pi * np.clip(width * turns, 0.0, 0.5))
    return np.clip(edge, 0.05, 2.0) ** -6


def _restricted_likelihood(
    equations: NormalEquations, least: Array, m: int, begin: Array | None
) -> tuple[_Posterior, Array, bool]:
    """Return the envelopes at the weights that maximise the restricted likelihood, the weights, and whether to stop.

    Args:
        equations: normal equations of the samples.
        least: least weight of each third difference over that of the data, shape (parts, knots).
        m: coefficients per knot.
        begin: initial weights, shape (parts,).
    Returns:
        The third value states whether the knots are dense enough.
    """
    owner = np.concatenate([[0], np.repeat(np.arange(1, (m + 1) // 2), 2)])  # offset, then two columns per order
    diagonal = equations.gram[:, 0].reshape(-1, m)
    data = np.array([diagonal[:, owner == j].mean() for j in range(len(least))])
    floor = data[:, None] * least
    weights = data if begin is None else begin
    found = _posterior(equations, weights, floor, owner)
    old = np.zeros(len(data))
    for _ in range(_MAX_STEPS):
        change = np.log(np.maximum(found.free.sum(axis=1), 1e-3) / np.maximum(found.taken.sum(axis=1), 1e-30))
        change = np.log(np.clip(weights * np.exp(change), data / _MAX_STIFFNESS**2, data * _MAX_STIFFNESS) / weights)
        if np.abs(change).max() < _MAX_LOG_CHANGE:
            break
        longer = weights * np.exp(np.where(change * old > 0, 1.6, 1.0) * change)  # steps in one direction are too short
        weights, old = np.clip(longer, data / _MAX_STIFFNESS**2, data * _MAX_STIFFNESS), change
        found = _posterior(equations, weights, floor, owner)
    return found, weights, bool((weights > _RESOLVED * data).all())


def _posterior(equations: NormalEquations, weights: Array, floor: Array, owner: NDArray[np.int64]) -> _Posterior:
    """Return the envelopes at weights of their parts, (parts,), above a floor, (parts, knots)."""
    own = weights[:, None] + floor
    m, columns = len(owner), np.bincount(owner)
    matrix = equations.gram + _penalty_band(own[owner])
    try:
        factor: Array = scipy.linalg.cholesky_banded(matrix.T, lower=True, check_finite=False)
    except np.linalg.LinAlgError as fault:
        raise ValueError("order tracking: the samples do not separate the orders") from fault
    beta: Array = scipy.linalg.cho_solve_banded((factor, True), equations.right, check_finite=False)
    inverse = _band_of_inverse(np.ascontiguousarray(factor.T))
    spread, energy = _differences(inverse, beta, owner, m, len(columns))
    freedom = columns * (own.shape[1] + 3) - (own * spread).sum(axis=1)
    rest = equations.total - float(beta @ equations.right) - float((own * energy).sum())
    variance = max(rest, 1e-28 * equations.total) / max(equations.samples - float(freedom.sum()), 1.0)
    variance = max(variance, equations.least_variance)
    free = np.maximum(columns[:, None] / own - spread, 0.0) * weights[:, None]
    return _Posterior(beta, inverse, variance, freedom, free, weights[:, None] * energy / variance)


def _roughness(free: Array, taken: Array) -> Array:
    """Return the roughness of each part about each knot over that of its single weight, shape (parts, knots)."""
    around, smoothed = _ROUGHNESS_KNOTS, scipy.ndimage.gaussian_filter1d
    return (smoothed(taken, around, axis=1) + 1e-9) / (smoothed(free, around, axis=1) + 1e-9)


def _penalty_band(rows: Array) -> Array:
    """Return the lower band of Dᵀ W D by columns, (N, 4 m), for third differences over knots; weights (m, knots)."""
    m, knots = rows.shape
    band = np.zeros((knots + 3, m, 4, m))
    for a in range(4):
        for c in range(a, 4):
            band[a : knots + a, :, c - a, 0] += _PENALTY[a] * _PENALTY[c] * rows.T
    return band.reshape((knots + 3) * m, 4 * m)


@compiled(nogil=True)
def _residuals(
    time: Array, signal: Array, phase: Array, start: float, step: float, coefficients: Array
) -> Array:  # pragma: no cover (compiled)
    """Return the signal without offset and orders."""
    out = np.empty(len(time))
    knots, m = len(coefficients) - 3, coefficients.shape[1]
    for i in range(len(time)):
        place = (time[i] - start) / step
        at = min(int(place), knots - 1)
        u = place - at
        c, s = math.cos(phase[i]), math.sin(phase[i])
        w0, w3 = (1.0 - u) ** 3 / 6.0, u**3 / 6.0
        w1, w2 = (4.0 - 6.0 * u**2 + 3.0 * u**3) / 6.0, (1.0 + 3.0 * u + 3.0 * u**2 - 3.0 * u**3) / 6.0
        near = coefficients[at : at + 4]
        value = w0 * near[0, 0] + w1 * near[1, 0] + w2 * near[2, 0] + w3 * near[3, 0]
        real, imaginary = c, s
        for k in range(1, m, 2):
            value += (w0 * near[0, k] + w1 * near[1, k] + w2 * near[2, k] + w3 * near[3, k]) * real
            k1 = k + 1
            value -= (w0 * near[0, k1] + w1 * near[1, k1] + w2 * near[2, k1] + w3 * near[3, k1]) * imaginary
            real, imaginary = real * c - imaginary * s, real * s + imaginary * c
        out[i] = signal[i] - value
    return out


@compiled(nogil=True)
def _differences(
    inverse: Array, beta: Array, owner: NDArray[np.int64], m: int, parts: int
) -> tuple[Array, Array]:  # pragma: no cover (compiled)
    """Return variance (in units of the noise) and square of each third difference, summed over a part's columns."""
    knots = len(beta) // m - 3
    spreads, energies = np.zeros((parts, knots)), np.zeros((parts, knots))
    for row in range(knots):
        for r in range(m):
            value, spread = 0.0, 0.0
            for a in range(4):
                j = (row + a) * m + r
                value += _PENALTY[a] * beta[j]
                spread += _PENALTY[a] ** 2 * inverse[j, 0]
                for c in range(a + 1, 4):
                    spread += 2.0 * _PENALTY[a] * _PENALTY[c] * inverse[j, (c - a) * m]
            spreads[owner[r], row] += spread
            energies[owner[r], row] += value * value
    return spreads, energies


@compiled(nogil=True)
def _band_of_inverse(factor: Array) -> Array:  # pragma: no cover (compiled)
    """Return the lower band of (L Lᵀ)⁻¹ by columns from that of L, both (N, width) (Takahashi's recursion)."""
    total, width = factor.shape
    out = np.zeros((total, width))
    for j in range(total - 1, -1, -1):
        last = min(width - 1, total - 1 - j)
        own = 1.0 / factor[j, 0]
        for d in range(1, last + 1):
            out[j, d] = 0.0
        for e in range(1, last + 1):  # Z_ij = −Σ_k L_kj Z_ik / L_jj, both halves of Z_ik from its lower band
            weight = factor[j, e] * own
            for d in range(e, last + 1):
                out[j, d] -= weight * out[j + e, d - e]
            for d in range(1, e):
                out[j, d] -= weight * out[j + d, e - d]
        value = own
        for e in range(1, last + 1):
            value -= factor[j, e] * out[j, e]
        out[j, 0] = value * own
    return out


@compiled(nogil=True)
def _moments(
    time: Array, signal: Array, phase: Array, start: float, step: float, knots: int, orders: int
) -> tuple[Array, Array]:  # pragma: no cover (compiled)
    """Return for each interval Σ u^p cos jψ and Σ u^p sin jψ (j to 2 K, p to 6), and Σ u^p x r (p to 3)."""
    highest = 2 * orders
    phasors = np.zeros((knots, highest + 1, 2, 7))
    products = np.zeros((knots, 2 * orders + 1, 4))
    for i in range(len(time)):
        place = (time[i] - start) / step
        at = min(int(place), knots - 1)
        u = place - at
        c, s = math.cos(phase[i]), math.sin(phase[i])
        real, imaginary = 1.0, 0.0
        for j in range(highest + 1):
            power = 1.0
            for p in range(7):
                phasors[at, j, 0, p] += power * real
                phasors[at, j, 1, p] += power * imaginary
                power *= u
            if j <= orders:
                power = signal[i]
                for p in range(4):
                    if j == 0:
                        products[at, 0, p] += power
                    else:
                        products[at, 2 * j - 1, p] += power * real
                        products[at, 2 * j, p] -= power * imaginary
                    power *= u
            real, imaginary = real * c - imaginary * s, real * s + imaginary * c
    return phasors, products


def _normal_equations(phasors: Array, products: Array, orders: int) -> tuple[Array, Array]:
    """Return lower band of XᵀX by columns, (N, 4 m), and Xᵀx, (N,); unknowns by knot, regressors 1, cos kψ, −sin kψ."""
    knots, m = len(phasors), 1 + 2 * orders
    pair = np.zeros((4, 4, 7))  # powers of u in the product of two splines
    for a in range(4):
        for c in range(4):
            pair[a, c] = np.convolve(_BASIS[a], _BASIS[c])
    by_order = np.einsum("kjqp,acp->kjqac", phasors, pair)
    local = np.zeros((knots, 4, m, 4, m))
    for r, (k, kind) in enumerate(_regressors(orders)):
        for s, (n, other) in enumerate(_regressors(orders)):
            local[:, :, r, :, s] = _product(by_order, k, kind, n, other)
    gram = np.zeros(((knots + 3) * m, 4 * m))
    dense = local.reshape(knots, 4 * m, 4 * m)
    for column in range(4 * m):
        for row in range(column, 4 * m):
            gram[column : column + knots * m : m, row - column] += dense[:, row, column]
    right = np.zeros((knots + 3, m))
    weighted = np.einsum("krp,ap->kar", products, _BASIS)
    for a in range(4):
        right[a : a + knots] += weighted[:, a]
    return gram, right.ravel()


def _regressors(orders: int) -> list[tuple[int, str]]:
    return [(0, "cos")] + [(k, kind) for k in range(1, orders + 1) for kind in ("cos", "sin")]


def _product(by_order: Array, k: int, kind: str, n: int, other: str) -> Array:
    """Return the sum of products of two regressors, cos kψ or −sin kψ, from the sums of cos jψ and sin jψ."""
    low, high = abs(k - n), k + n
    sign = 1.0 if k >= n else -1.0
    if kind == other == "cos":
        return 0.5 * (by_order[:, low, 0] + by_order[:, high, 0])
    if kind == other == "sin":
        return 0.5 * (by_order[:, low, 0] - by_order[:, high, 0])
    if kind == "sin":  # −sin kψ cos nψ
        return -0.5 * (by_order[:, high, 1] + sign * by_order[:, low, 1])
    return -0.5 * (by_order[:, high, 1] - sign * by_order[:, low, 1])


def _blocks(inverse: Array, knots: int, m: int) -> Array:
    """Return the covariance of the four splines' coefficients of each interval, shape (knots, 4 m, 4 m)."""
    out = np.zeros((knots, 4 * m, 4 * m))
    for column in range(4 * m):
        for row in range(column, 4 * m):
            band = inverse[column : column + knots * m : m, row - column]
            out[:, row, column] = band
            out[:, column, row] = band
    return out
