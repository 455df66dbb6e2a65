"""Half-turn matrices of a whole rectangle of a map, interpolated from a few of them.

D Φ(π) is an entire function of the springs, dampers and pendulum rates per radian of phase. Over a rectangle of
coordinates in which these are smooth (1/Ω and √K, because modes turn by phases π ω_n/ω), its Chebyshev series
therefore decreases faster than any power once it has more terms than half the rectangle's phase. A map of 300 × 400
points needs about 2000 matrices.
Source: L. N. Trefethen, Approximation Theory and Approximation Practice, SIAM 2013, chapters 3, 8 and 17.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array

MatricesAt = Callable[[Array, Array, bool], Array]
"""Matrices at u and v, shape (points,) each: shape (points, n, n). True: more accurate than those of the nodes."""

_EPS = float(np.finfo(float).eps)
MAX_NODES = 64
_ROUNDINGS = 16.0  # rounding of the sums of the series, in roundings of a matrix's norm
_TAIL = 4.0  # bound on the remainder over the last two terms, for a series that at least halves with each term
_CHECKED_POINTS = 12  # points, in addition to the corners, at which the surface is compared with the matrix
_SAFETY = 2.0  # factor on the largest of these differences


@dataclass(frozen=True)
class MatrixSurface:
    """Matrices over a rectangle of coordinates u and v.

    Attributes:
        u_range, v_range: the rectangle.
        nodes: matrices at the Chebyshev points of the first kind, shape (n_v, n_u, n, n).
        error: bound on the Frobenius norm of a matrix's error, in the units of the nodes.
    """

    u_range: tuple[float, float]
    v_range: tuple[float, float]
    nodes: Array
    error: float

    def weights_u(self, u: Array) -> Array:
        """Weight of each column of nodes in the matrix at u, shape (len(u), n_u)."""
        return lagrange_basis(self.nodes.shape[1], self.u_range, u)

    def weights_v(self, v: Array) -> Array:
        """Weight of each row of nodes in the matrix at v, shape (len(v), n_v)."""
        return lagrange_basis(self.nodes.shape[0], self.v_range, v)

    def slopes_u(self, u: Array) -> Array:
        """Derivatives of `weights_u` by u, shape (len(u), n_u)."""
        return lagrange_slopes(self.nodes.shape[1], self.u_range, u)

    def slopes_v(self, v: Array) -> Array:
        """Derivatives of `weights_v` by v, shape (len(v), n_v)."""
        return lagrange_slopes(self.nodes.shape[0], self.v_range, v)


def nodes_needed(span: tuple[float, float], half_phase_rad: float) -> int:
    """Number of terms of the Chebyshev series of e^{i x u}, |u| ≤ 1, down to rounding: x + O(x^⅓) plus a constant."""
    if span[0] == span[1]:
        return 1
    return math.ceil(half_phase_rad + 7.0 * half_phase_rad ** (1 / 3) + 8.0)


def _angles(n: int) -> Array:
    return np.asarray((np.pi / n) * (np.arange(n) + 0.5), np.float64)


def chebyshev_points(n: int, span: tuple[float, float]) -> Array:
    """Chebyshev points of the first kind in an interval, shape (n,), in descending order."""
    low, high = span
    return (low + high) / 2 + (high - low) / 2 * np.cos(_angles(n))


def lagrange_basis(n: int, span: tuple[float, float], at: Array) -> Array:
    """Values of the Lagrange polynomials of `chebyshev_points`, shape (len(at), n)."""
    low, high = span
    if n == 1:
        return np.ones((len(at), 1))
    order = np.arange(n)
    angle = np.arccos(np.clip((2 * at - low - high) / (high - low), -1.0, 1.0))
    weight = np.where(order == 0, 1.0, 2.0) / n
    return np.cos(angle[:, None] * order) @ (weight[:, None] * np.cos(order[:, None] * _angles(n)))


def lagrange_slopes(n: int, span: tuple[float, float], at: Array) -> Array:
    """Derivatives of `lagrange_basis` by the interval's coordinate, shape (len(at), n)."""
    low, high = span
    if n == 1:
        return np.zeros((len(at), 1))
    order = np.arange(n)
    share = np.clip((2 * at - low - high) / (high - low), -1.0, 1.0)
    second = np.zeros((len(at), n))  # U_j-1, of which T_j' = j U_j-1
    second[:, 1] = 1.0
    for j in range(2, n):
        second[:, j] = 2 * share * second[:, j - 1] - second[:, j - 2]
    weight = np.where(order == 0, 1.0, 2.0) / n
    return 2 / (high - low) * (second * order) @ (weight[:, None] * np.cos(order[:, None] * _angles(n)))


def fit_surface(
    matrices_at: MatricesAt,
    u_range: tuple[float, float],
    v_range: tuple[float, float],
    half_phases_rad: tuple[float, float],
    wanted: float,
) -> MatrixSurface | None:
    """Interpolate matrices over a rectangle.

    The error bound is the sum of four times the last two terms of both series, of rounding, and of twice the largest
    difference from matrices with one and a half times the steps, at the corners and at twelve points between the nodes.
    All nodes have the same number of steps, so the error of the steps is smooth.

    Args:
        matrices_at: function that computes matrices.
        u_range, v_range: the rectangle; low = high makes it a line.
        half_phases_rad: half the phase of the fastest mode over the rectangle, along u and along v, rad.
        wanted: permitted error relative to the largest norm.
    Returns:
        The surface, or None if `MAX_NODES` nodes along a side do not reach the permitted error.
    """
    n_u, n_v = (nodes_needed(span, phase) for span, phase in zip((u_range, v_range), half_phases_rad, strict=True))
    while max(n_u, n_v) <= MAX_NODES:
        u, v = chebyshev_points(n_u, u_range), chebyshev_points(n_v, v_range)
        found = matrices_at(np.tile(u, n_v), np.repeat(v, n_u), False)
        if not np.all(np.isfinite(found)):
            return None
        nodes = found.reshape(n_v, n_u, *found.shape[1:])
        norm = float(np.max(np.linalg.norm(found, axis=(1, 2))))
        tail_u, tail_v = _last_terms(nodes, 1), _last_terms(nodes, 0)
        if max(tail_u, tail_v) <= wanted * norm:
            error = _TAIL * (tail_u + tail_v) + _ROUNDINGS * _EPS * norm
            return _with_checked_error(MatrixSurface(u_range, v_range, nodes, error), matrices_at)
        n_u += n_u // 8 if tail_u > wanted * norm else 0
        n_v += n_v // 8 if tail_v > wanted * norm else 0
    return None


def _last_terms(nodes: Array, axis: int) -> float:
    """Largest Frobenius norm of the last two terms of the Chebyshev series along an axis."""
    n = nodes.shape[axis]
    if n == 1:
        return 0.0
    cosines = np.cos(np.array([[n - 2], [n - 1]]) * _angles(n))
    terms = np.tensordot(2.0 / n * cosines, nodes, (1, axis))
    return float(np.max(np.linalg.norm(terms, axis=(-2, -1))))


def _with_checked_error(surface: MatrixSurface, matrices_at: MatricesAt) -> MatrixSurface:
    """The surface with an error bound that includes its deviations at the corners and at points spread over it."""
    turn, corner = np.arange(1, _CHECKED_POINTS + 1), np.arange(4)
    shares = np.concatenate([(0.7548776662466927 * turn) % 1.0, corner % 2])  # of Roberts' R2
    other = np.concatenate([(0.5698402909980532 * turn) % 1.0, corner // 2])
    u, v = (
        np.asarray(low + (high - low) * at, np.float64)
        for (low, high), at in ((surface.u_range, shares), (surface.v_range, other))
    )
    there = np.einsum("pv,pu,vuij->pij", surface.weights_v(v), surface.weights_u(u), surface.nodes)
    apart = float(np.max(np.linalg.norm(there - matrices_at(u, v, True), axis=(1, 2))))
    return dataclasses.replace(surface, error=surface.error + _SAFETY * apart)
