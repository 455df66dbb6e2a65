"""A border between its computed points: cubics with exact tangents, refined until the curve itself is exact.

In the unit square a border is a level line of e = |λ|² − 1, so its tangent is i ∇e / |∇e| (the stable side on the
left), with ∇e = 2 Re(λ̄ ∇λ). Between two points the curve is the cubic with their tangents and the speed of a circular
arc: |chord| / cos²(turn/4). At the middle, where the error is largest, the cubic is compared with e. The middle is
moved to the border and becomes a point of the curve. If the error there exceeds 10⁻¹¹, both halves are refined in the
same way. The error decreases with the fourth power of the length, so the remaining error is a sixteenth of it. (At the
middle, the sixth-order error of an arc is not visible: it is below 10⁻¹² of the radius for pieces that turn by a few
degrees, which is the case for followed borders.) Only at corners, where one multiplier overtakes another, the
refinement ends at 10⁻⁶. There the curve is straight.
Source: C. de Boor, K. Höllig, M. Sabin, High accuracy geometric Hermite interpolation, CAGD 4 (1987) 269.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.arrays import Array, Complex, Flags
from dynamics.stability.border_crossings import roots
from dynamics.stability.border_following import SHORTEST

Slopes = Callable[[Complex], tuple[Complex, Complex, Complex]]
"""λ, ∂λ/∂X and ∂λ/∂Y at points X + i Y of the unit square, shape (points,) each. Of a pair the one with Im λ ≥ 0."""

WANTED = 1e-11  # of the square: largest error at the middle of a piece that is not refined
CORNER = 1.5 * SHORTEST  # of the square: length up to which pieces are straight
_ROUNDING = 4e-13  # of e: smaller values count as zero
_ANGLE = 1e-9  # rad: largest error of the cubic of arg λ
_SAME = 1e-9  # of the square: distance below which two points are merged
_LEAN = 0.5  # smallest cosine between a piece and the tangents at its ends and its middle
_ROUNDS, _MOVES = 48, 4
_WIDE = (0.05, 0.5)  # of a piece: half-widths of the search for the border on both sides of its middle
_CHUNK = 256  # number of points processed at a time
_ON = 1e-8  # of the square: distance up to which a point lies on the curve


@dataclass(frozen=True)
class BorderCurve:
    """Consecutive cubics in the unit square that represents a range.

    Attributes:
        points: X + i Y, exact, shape (n,); the stable side is on the left.
        tangents: unit tangents, shape (n,).
        roots: λ at the points, Im λ ≥ 0, shape (n,). The multipliers are their squares.
        turning: derivative of arg λ with respect to the length along the curve, shape (n,).
        off: largest distance from the border found at the middle of a piece before that place became a point. The
            remaining error is about a sixteenth of it. Straight pieces at corners are not included.
    """

    points: Complex
    tangents: Complex
    roots: Complex
    turning: Array
    off: float = 0.0

    def between(self, spacing: float) -> tuple[Complex, Complex]:
        """Points of the curve at most a fraction of the square apart, its own points included, and λ; shape (m,)."""
        piece = np.arange(len(self.points) - 1)
        start, leaves, arrives, end = _controls(self, piece)
        fastest = np.max(np.abs([leaves, 3 * (end - start) - leaves - arrives, arrives]), axis=0)
        counts = np.maximum(np.ceil(fastest / spacing), 1).astype(np.intp)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        piece = np.repeat(piece, counts)
        at, root = _on_cubics(self, piece, (np.arange(len(piece)) - first) / counts[piece])
        return np.append(at, self.points[-1]), np.append(root, self.roots[-1])

    def holds(self, at: Complex, tangents: Complex) -> Flags:
        """Whether points of borders lie on this curve, shape (m,).

        Args:
            at, tangents: points and tangents of their borders, shape (m,). On the other side of a thin band the
                tangent has the opposite direction.
        """
        found = np.zeros(len(at), bool)
        middles, reaches = (self.points[:-1] + self.points[1:]) / 2, 0.55 * np.abs(np.diff(self.points)) + 2 * CORNER
        for start in range(0, len(at), _CHUNK):
            off = at[start : start + _CHUNK, None] - middles
            which, piece = np.nonzero(off.real**2 + off.imag**2 <= reaches**2)
            which += start
            lies = self._passes(piece, at[which], tangents[which])
            found[which[lies]] = True
        return found

    def _passes(self, piece: NDArray[np.intp], at: Complex, tangents: Complex) -> Flags:
        """Whether pieces pass through points in their direction, shape (pairs,); points next to a corner count."""
        start = self.points[piece]
        chord = self.points[piece + 1] - start
        share = (at - start) / chord
        along = share.real.copy()
        for _ in range(3):  # the speed of the cubic along its chord is nearly constant
            along = np.clip(along + share.real - ((_on_cubics(self, piece, along)[0] - start) / chord).real, 0.0, 1.0)
        off = np.abs(_on_cubics(self, piece, along)[0] - at)
        straight = np.abs(chord) <= CORNER
        return ((off <= _ON) & ((np.conj(tangents) * chord).real > 0)) | (straight & (off <= 2 * CORNER))


def _controls(curve: BorderCurve, piece: NDArray[np.intp]) -> tuple[Complex, Complex, Complex, Complex]:
    """Start, derivatives at both ends, and end of pieces with parameter 0 … 1."""
    start, end = curve.points[piece], curve.points[piece + 1]
    chord = end - start
    turn = np.abs(np.angle(curve.tangents[piece + 1] * np.conj(curve.tangents[piece])))
    speed = np.abs(chord) / np.cos(turn / 4) ** 2
    straight = np.abs(chord) <= CORNER
    leaves, arrives = (np.where(straight, chord, speed * curve.tangents[piece + k]) for k in (0, 1))
    return start, leaves, arrives, end


def _on_cubics(curve: BorderCurve, piece: NDArray[np.intp], share: Array) -> tuple[Complex, Complex]:
    """Points at parameters 0 … 1 of pieces, and λ there."""
    start, leaves, arrives, end = _controls(curve, piece)
    root, last = curve.roots[piece], curve.roots[piece + 1]
    gained = np.where(np.abs(end - start) <= CORNER, 0.0, np.angle(last * np.conj(root)))
    first, second = curve.turning[piece] * np.abs(leaves), curve.turning[piece + 1] * np.abs(arrives)
    angle = _cubic(np.zeros(len(piece), complex), _complex(first), _complex(second), _complex(gained), share).real
    size = np.abs(root) ** (1 - share) * np.abs(last) ** share
    return _cubic(start, leaves, arrives, end, share), size * root / np.abs(root) * np.exp(1j * angle)


def _complex(values: ArrayLike) -> Complex:
    return np.asarray(values, np.complex128)


def _cubic(start: Complex, leaves: Complex, arrives: Complex, end: Complex, share: Array) -> Complex:
    """Cubic with given values and derivatives at its ends."""
    rest = 1 - share
    return rest**2 * ((1 + 2 * share) * start + share * leaves) + share**2 * ((1 + 2 * rest) * end - rest * arrives)


def curve_through(points: Complex, slopes: Slopes) -> BorderCurve:
    """Curve through points of a border, refined until it is exact.

    Args:
        points: exact points in order, the stable side on the left, shape (n,), n ≥ 2.
        slopes: λ and its derivatives.
    Returns:
        The curve. If the refinement of a piece fails, `off` is half the length of that piece.
    """
    points = _apart(points)
    seen = _border_data(points, slopes)
    curve = BorderCurve(points, seen.tangents, seen.roots, seen.turning)
    waiting = np.abs(np.diff(points)) > CORNER
    for _ in range(_ROUNDS):
        piece = np.flatnonzero(waiting)
        if len(piece) == 0:
            return curve
        halves = np.full(len(piece), 0.5)
        middle, root = _on_cubics(curve, piece, halves)
        seen = _border_data(middle, slopes)
        chord = curve.points[piece + 1] - curve.points[piece]
        ways = (curve.tangents[piece], curve.tangents[piece + 1], seen.tangents)
        fits = (np.abs(seen.off) <= WANTED) & (np.abs(np.angle(root * np.conj(seen.roots))) <= _ANGLE)
        fits &= np.min([_lean(chord, way) for way in ways], axis=0) >= _LEAN
        moved = _moved(curve, piece[~fits], middle[~fits], slopes)
        found, rest = ~np.isnan(moved), piece[~fits]
        off = max(curve.off, float(np.max(np.abs(seen.off[fits]), initial=0.0)), _longest(curve, rest[~found]) / 2)
        waiting[piece[fits]], waiting[rest[~found]] = False, False
        more = np.concatenate([piece[fits], rest[found]])
        there = _joined(seen.some(fits), _border_data(moved[found], slopes))
        curve, waiting = _with_more(replace(curve, off=off), waiting, more, there)
    return replace(curve, off=max(curve.off, _longest(curve, np.flatnonzero(waiting)) / 2))


def curve_tangents(at: Complex, slopes: Slopes) -> Complex:
    """Unit tangents of borders at points on them, the stable side on the left, shape (points,)."""
    return _border_data(at, slopes).tangents


def _apart(points: Complex) -> Complex:
    """The points without those that coincide with the one before or with the last one."""
    kept = np.append(True, np.abs(np.diff(points)) > _SAME)
    if not kept[-1] and np.count_nonzero(kept) > 1:
        kept[np.flatnonzero(kept)[-1]], kept[-1] = False, True
    return points[kept]


@dataclass(frozen=True)
class _BorderData:
    """Properties of points near a border, shape (points,) each.

    Attributes:
        off: distance from the border, along ∇e.
        points: next Newton iterates.
        tangents, roots, turning: see BorderCurve.
    """

    off: Complex
    points: Complex
    tangents: Complex
    roots: Complex
    turning: Array

    def some(self, which: Flags) -> _BorderData:
        """Selection of the points."""
        return _BorderData(
            self.off[which], self.points[which], self.tangents[which], self.roots[which], self.turning[which]
        )


def _joined(first: _BorderData, second: _BorderData) -> _BorderData:
    """Points of the first object followed by those of the second."""
    return _BorderData(
        np.append(first.off, second.off),
        np.append(first.points, second.points),
        np.append(first.tangents, second.tangents),
        np.append(first.roots, second.roots),
        np.append(first.turning, second.turning),
    )


def _border_data(at: Complex, slopes: Slopes) -> _BorderData:
    root, along_x, along_y = slopes(at)
    excess = np.abs(root) ** 2 - 1
    gradient = 2 * ((np.conj(root) * along_x).real + 1j * (np.conj(root) * along_y).real)
    steep = np.maximum(np.abs(gradient), 1e-300)
    with np.errstate(invalid="ignore"):  # NaN where the matrix does not exist
        tangents = 1j * gradient / steep
        off = np.where(np.abs(excess) <= _ROUNDING, 0.0, excess) * gradient / steep**2
        turning = ((along_x * tangents.real + along_y * tangents.imag) / root).imag
    return _BorderData(off, at - off, tangents, root - along_x * off.real - along_y * off.imag, turning)


def _lean(chord: Complex, tangents: Complex) -> Array:
    """Cosines of the angles between chords and tangents."""
    return (np.conj(chord) * tangents).real / np.abs(chord)


def _longest(curve: BorderCurve, piece: NDArray[np.intp]) -> float:
    return float(np.max(np.abs(curve.points[piece + 1] - curve.points[piece]), initial=0.0))


def _with_more(
    curve: BorderCurve, waiting: Flags, piece: NDArray[np.intp], more: _BorderData
) -> tuple[BorderCurve, Flags]:
    """The curve with one additional point in some of its pieces."""
    where = piece + 1
    points, tangents, roots_there = (
        np.insert(old, where, new)
        for old, new in (
            (curve.points, more.points),
            (curve.tangents, more.tangents),
            (curve.roots, more.roots),
        )
    )
    curve = BorderCurve(points, tangents, roots_there, np.insert(curve.turning, where, more.turning), curve.off)
    return curve, np.insert(waiting, where, waiting[piece]) & (np.abs(np.diff(points)) > CORNER)


def _moved(curve: BorderCurve, piece: NDArray[np.intp], near: Complex, slopes: Slopes) -> Complex:
    """Points of the border in pieces, by Newton's method along ∇e or by a search across the middle of the piece.

    NaN if both fail.
    """
    start, chord = curve.points[piece], curve.points[piece + 1] - curve.points[piece]
    at, off = near.copy(), np.full(len(near), np.inf)
    for _ in range(_MOVES):
        going = np.flatnonzero(np.abs(off) > WANTED / 10)
        if len(going) == 0:
            break
        step = _border_data(at[going], slopes).off
        at[going], off[going] = at[going] - step, np.abs(step)
    share = (at - start) / chord
    lost = np.flatnonzero(
        ~(off <= WANTED / 10)
        | (np.abs(share.real - 0.5) > 0.3)
        | (np.abs(share.imag) > 0.3)
        | (_lean(chord, _border_data(at, slopes).tangents) < _LEAN)
    )
    for wide in _WIDE:
        lost = lost[~_between_both_sides(at, lost, start[lost], chord[lost], wide, slopes)]
    at[lost] = np.nan
    return at


def _between_both_sides(
    at: Complex, which: NDArray[np.intp], start: Complex, chord: Complex, wide: float, slopes: Slopes
) -> Flags:
    """Write the crossings of the border with the normal at the middle of pieces to at; return where one exists."""

    def excess(some: NDArray[np.intp], share: Array) -> Array:
        across = start[some] + chord[some] * (0.5 + 1j * wide * (1 - 2 * share))
        return np.abs(slopes(across)[0]) ** 2 - 1

    every = np.arange(len(which))
    left, right = (excess(every, np.full(len(which), share)) for share in (0.0, 1.0))
    crossed = np.flatnonzero((left < 0) & (right >= 0))
    found = roots(lambda some, share: excess(crossed[some], share), left[crossed], right[crossed])
    at[which[crossed]] = start[crossed] + chord[crossed] * (0.5 + 1j * wide * (1 - 2 * found))
    return np.isin(every, crossed)
