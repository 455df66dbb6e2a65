# pyright: strict
"""Half-turn matrices of a whole rectangle of a map, interpolated from few of them.

D Φ(π) is an entire function of the springs, dampers and pendulum rates per radian of phase, so over a rectangle of
s = 1/Ω and r = √K (the fundamental matrix turns with the phases ω_n s) its Chebyshev series falls faster than any
power as soon as it has more terms than half the rectangle's phase. A map of 300 × 400 points needs some 2000 matrices.
Source: L. N. Trefethen, Approximation Theory and Approximation Practice, SIAM 2013, chapters 3, 8 and 17.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MatricesAt = Callable[[NDArray[np.floating], NDArray[np.floating], bool], NDArray[np.floating]]
"""Matrices at s and r, each of shape (points,): shape (points, n, n). True: more accurate than those of the nodes."""

_EPS = float(np.finfo(float).eps)
MOST_NODES = 64
_ROUNDINGS = 16.0  # of a matrix's norm: of the sums of the series
_TAIL = 4.0  # a series that falls by half or more each term leaves less than its last two terms
_HELD_OUT = 12  # points, beside the corners, at which the surface is held against the matrix itself
_SAFETY = 2.0  # on the largest of their differences


@dataclass(frozen=True)
class MatrixSurface:
    """Matrices over a rectangle of s and r.

    Attributes:
        s_range, r_range: the rectangle.
        nodes: matrices at the Chebyshev points of the first kind, shape (n_r, n_s, n, n).
        error: bound on the Frobenius norm of a matrix's error, in the units of the nodes.
    """

    s_range: tuple[float, float]
    r_range: tuple[float, float]
    nodes: NDArray[np.floating]
    error: float

    def weights_s(self, s: NDArray[np.floating]) -> NDArray[np.floating]:
        """Share of each column of nodes in the matrix at s, shape (len(s), n_s)."""
        return lagrange_basis(self.nodes.shape[1], self.s_range, s)

    def weights_r(self, r: NDArray[np.floating]) -> NDArray[np.floating]:
        """Share of each row of nodes in the matrix at r, shape (len(r), n_r)."""
        return lagrange_basis(self.nodes.shape[0], self.r_range, r)


def nodes_needed(span: tuple[float, float], half_phase_rad: float) -> int:
    """Terms after which the Chebyshev series of e^{i x u}, |u| ≤ 1, has fallen to rounding: x + O(x^⅓) and some."""
    if span[0] == span[1]:
        return 1
    return math.ceil(half_phase_rad + 7.0 * half_phase_rad ** (1 / 3) + 12.0)


def chebyshev_points(n: int, span: tuple[float, float]) -> NDArray[np.floating]:
    """Chebyshev points of the first kind in an interval, shape (n,), from its end to its beginning."""
    low, high = span
    return (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(n) + 0.5) / n)


def lagrange_basis(n: int, span: tuple[float, float], at: NDArray[np.floating]) -> NDArray[np.floating]:
    """Values of the Lagrange polynomials of `chebyshev_points`, shape (len(at), n)."""
    low, high = span
    if n == 1:
        return np.ones((len(at), 1))
    u = np.clip((2 * at - low - high) / (high - low), -1.0, 1.0)
    order, nodes = np.arange(n), np.pi * (np.arange(n) + 0.5) / n
    weight = np.full(n, 2.0 / n)
    weight[0] = 1.0 / n
    return np.cos(np.arccos(u)[:, None] * order) @ (weight[:, None] * np.cos(order[:, None] * nodes))


def fit_surface(
    matrices_at: MatricesAt,
    s_range: tuple[float, float],
    r_range: tuple[float, float],
    half_phases_rad: tuple[float, float],
    wanted: float,
) -> MatrixSurface | None:
    """Interpolate matrices over a rectangle.

    Args:
        matrices_at: computes them.
        s_range, r_range: the rectangle; low = high makes it a line.
        half_phases_rad: half the phase that the fastest mode turns over the rectangle, along s and along r.
        wanted: error that is good enough, relative to the largest norm.
    Returns:
        The surface; None where `MOST_NODES` nodes along a side do not reach what is wanted.
    """
    n_s, n_r = (nodes_needed(span, phase) for span, phase in zip((s_range, r_range), half_phases_rad, strict=True))
    while max(n_s, n_r) <= MOST_NODES:
        s, r = chebyshev_points(n_s, s_range), chebyshev_points(n_r, r_range)
        found = matrices_at(np.tile(s, n_r), np.repeat(r, n_s), False)
        if not np.all(np.isfinite(found)):
            return None
        nodes = found.reshape(n_r, n_s, *found.shape[1:])
        norm = float(np.max(np.linalg.norm(found, axis=(1, 2))))
        tail_s, tail_r = _last_terms(nodes, 1), _last_terms(nodes, 0)
        if max(tail_s, tail_r) <= wanted * norm:
            error = _TAIL * (tail_s + tail_r) + _ROUNDINGS * _EPS * norm
            return _held_against(MatrixSurface(s_range, r_range, nodes, error), matrices_at)
        n_s += n_s // 4 if tail_s > wanted * norm else 0
        n_r += n_r // 4 if tail_r > wanted * norm else 0
    return None


def _last_terms(nodes: NDArray[np.floating], axis: int) -> float:
    """Largest Frobenius norm of the last two terms of the Chebyshev series along an axis."""
    n = nodes.shape[axis]
    if n == 1:
        return 0.0
    orders, at = np.array([n - 2, n - 1]), np.pi * (np.arange(n) + 0.5) / n
    terms = np.tensordot(2.0 / n * np.cos(orders[:, None] * at), nodes, (1, axis))
    return float(np.max(np.linalg.norm(terms, axis=(-2, -1))))


def _held_against(surface: MatrixSurface, matrices_at: MatricesAt) -> MatrixSurface:
    """The surface with an error that covers what it is off by at its corners and at points spread over it."""
    turn, corner = np.arange(1, _HELD_OUT + 1), np.arange(4)
    shares = np.concatenate([(0.7548776662466927 * turn) % 1.0, corner % 2])  # of Roberts' R2
    other = np.concatenate([(0.5698402909980532 * turn) % 1.0, corner // 2])
    s, r = (low + (high - low) * at for (low, high), at in ((surface.s_range, shares), (surface.r_range, other)))
    there = np.einsum("pr,ps,rsij->pij", surface.weights_r(r), surface.weights_s(s), surface.nodes)
    apart = float(np.max(np.linalg.norm(there - matrices_at(s, r, True), axis=(1, 2))))
    return dataclasses.replace(surface, error=surface.error + _SAFETY * apart)
