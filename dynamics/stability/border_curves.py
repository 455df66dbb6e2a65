# pyright: strict
"""A border between its points: cubics with exact tangents, as many as it takes for the curve itself to be exact.

In the unit square a border is a level line of e = |λ|² − 1, so its tangent is i ∇e / |∇e| (what is stable on the left
hand), with ∇e = 2 Re(λ̄ ∇λ). Between two points the curve is the cubic with their tangents, as long as for an arc of a
circle: |chord| / cos²(turn/4). Halfway, where it is off most, it is held against e, and the place is moved on to the
border and becomes one of the curve's own points; where it was off by more than 10⁻¹¹, both halves are treated the same
way. The error falls with the fourth power of the length, so what is left is a sixteenth of that. (Halfway an arc shows
none of its error of sixth order: below 10⁻¹² of its radius where pieces turn by a few degrees, as those that were
followed do.) Only at corners, where one multiplier overtakes another, all this ends at 10⁻⁶: there the curve is
straight.
Source: C. de Boor, K. Höllig, M. Sabin, High accuracy geometric Hermite interpolation, CAGD 4 (1987) 269.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.stability.border_crossings import roots
from dynamics.stability.border_following import SHORTEST

Array = NDArray[np.floating]
Complex = NDArray[np.complexfloating]
Flags = NDArray[np.bool_]
Slopes = Callable[[Complex], tuple[Complex, Complex, Complex]]
"""λ, ∂λ/∂X and ∂λ/∂Y at points X + i Y of the unit square, each of shape (points,); of a pair that with Im λ ≥ 0."""

WANTED = 1e-11  # of the square: how far the curve may be off halfway between two points, before it is halved there
CORNER = 1.5 * SHORTEST  # of the square: pieces up to there are straight
_ROUNDING = 4e-13  # of e: what is smaller is no distance
_ANGLE = 1e-9  # rad: how far arg λ may be off its cubic
_SAME = 1e-9  # of the square: points nearer to each other are one
_LEAN = 0.5  # least cosine between a piece and the tangents at its ends and halfway
_ROUNDS, _MOVES = 48, 4
_WIDE = (0.05, 0.5)  # of a piece: where the border is looked for on both sides of its middle
_SOME = 256  # points at a time
_ON = 1e-8  # of the square: what is nearer to the curve lies on it


@dataclass(frozen=True)
class BorderCurve:
    """Cubics in the unit square that stands for a range, one after the other.

    Attributes:
        points: X + i Y, exact, shape (n,); what is stable lies on the left hand.
        tangents: of length one, shape (n,).
        roots: λ at the points, Im λ ≥ 0, shape (n,): the multipliers are its squares.
        turning: d arg λ by the length along the curve, shape (n,).
        off: largest distance from the border found halfway between two points before that place became a point too;
            what is between is off by about a sixteenth of that. Straight pieces at corners are left out.
    """

    points: Complex
    tangents: Complex
    roots: Complex
    turning: Array
    off: float = 0.0

    def between(self, spacing: float) -> tuple[Complex, Complex]:
        """Points of the curve no farther apart than a share of the square, its own among them, with λ, shape (m,)."""
        piece = np.arange(len(self.points) - 1)
        start, leaves, arrives, end = _controls(self, piece)
        fastest = np.max(np.abs([leaves, 3 * (end - start) - leaves - arrives, arrives]), axis=0)
        counts = np.maximum(np.ceil(fastest / spacing), 1).astype(np.intp)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        piece = np.repeat(piece, counts)
        at, root = _on_cubics(self, piece, (np.arange(len(piece)) - first) / counts[piece])
        return np.append(at, self.points[-1]), np.append(root, self.roots[-1])

    def holds(self, at: Complex, tangents: Complex) -> Flags:
        """Which points of borders lie on this one, shape (m,).

        Args:
            at, tangents: the points, and their borders' tangents, shape (m,): the other side of a thin band turns back.
        """
        found = np.zeros(len(at), bool)
        middles, reaches = (self.points[:-1] + self.points[1:]) / 2, 0.55 * np.abs(np.diff(self.points)) + 2 * CORNER
        for start in range(0, len(at), _SOME):
            off = at[start : start + _SOME, None] - middles
            which, piece = np.nonzero(off.real**2 + off.imag**2 <= reaches**2)
            which += start
            lies = self._passes(piece, at[which], tangents[which])
            found[which[lies]] = True
        return found

    def _passes(self, piece: NDArray[np.intp], at: Complex, tangents: Complex) -> Flags:
        """Whether pieces pass points with the same direction, shape (pairs,); what is next to a corner always does."""
        start = self.points[piece]
        chord = self.points[piece + 1] - start
        share = (at - start) / chord
        along = share.real.copy()
        for _ in range(3):  # the cubic runs along its chord at nearly even speed
            along = np.clip(along + share.real - ((_on_cubics(self, piece, along)[0] - start) / chord).real, 0.0, 1.0)
        off = np.abs(_on_cubics(self, piece, along)[0] - at)
        straight = np.abs(chord) <= CORNER
        return ((off <= _ON) & ((np.conj(tangents) * chord).real > 0)) | (straight & (off <= 2 * CORNER))


def _controls(curve: BorderCurve, piece: NDArray[np.intp]) -> tuple[Complex, Complex, Complex, Complex]:
    """Start, derivatives at both ends and end of pieces, whose parameter runs from 0 to 1."""
    start, end = curve.points[piece], curve.points[piece + 1]
    chord = end - start
    turn = np.abs(np.angle(curve.tangents[piece + 1] * np.conj(curve.tangents[piece])))
    speed = np.abs(chord) / np.cos(turn / 4) ** 2
    straight = np.abs(chord) <= CORNER
    leaves, arrives = (np.where(straight, chord, speed * curve.tangents[piece + k]) for k in (0, 1))
    return start, leaves, arrives, end


def _on_cubics(curve: BorderCurve, piece: NDArray[np.intp], share: Array) -> tuple[Complex, Complex]:
    """Points at parameters 0 … 1 of pieces, with λ."""
    start, leaves, arrives, end = _controls(curve, piece)
    root, last = curve.roots[piece], curve.roots[piece + 1]
    gained = np.where(np.abs(end - start) <= CORNER, 0.0, np.angle(last * np.conj(root)))
    first, second = curve.turning[piece] * np.abs(leaves), curve.turning[piece + 1] * np.abs(arrives)
    angle = _cubic(np.zeros(len(piece), complex), first + 0j, second + 0j, gained + 0j, share).real
    size = np.abs(root) ** (1 - share) * np.abs(last) ** share
    return _cubic(start, leaves, arrives, end, share), size * root / np.abs(root) * np.exp(1j * angle)


def _cubic(start: Complex, leaves: Complex, arrives: Complex, end: Complex, share: Array) -> Complex:
    """Cubic with values and derivatives at its ends."""
    rest = 1 - share
    return rest**2 * ((1 + 2 * share) * start + share * leaves) + share**2 * ((1 + 2 * rest) * end - rest * arrives)


def curve_through(points: Complex, slopes: Slopes) -> BorderCurve:
    """The curve through points of a border, with as many more as it takes.

    Args:
        points: in order, exact, what is stable on the left hand, shape (n,), n ≥ 2.
        slopes: of λ.
    Returns:
        The curve; where no more points are found its `off` is half the length of the piece that is left without.
    """
    points = _apart(points)
    seen = _looked_at(points, slopes)
    curve = BorderCurve(points, seen.tangents, seen.roots, seen.turning)
    waiting = np.abs(np.diff(points)) > CORNER
    for _ in range(_ROUNDS):
        piece = np.flatnonzero(waiting)
        if len(piece) == 0:
            return curve
        halves = np.full(len(piece), 0.5)
        middle, root = _on_cubics(curve, piece, halves)
        seen = _looked_at(middle, slopes)
        chord = curve.points[piece + 1] - curve.points[piece]
        ways = (curve.tangents[piece], curve.tangents[piece + 1], seen.tangents)
        fits = (np.abs(seen.off) <= WANTED) & (np.abs(np.angle(root * np.conj(seen.roots))) <= _ANGLE)
        fits &= np.min([_lean(chord, way) for way in ways], axis=0) >= _LEAN
        moved = _moved(curve, piece[~fits], middle[~fits], slopes)
        found, rest = ~np.isnan(moved), piece[~fits]
        off = max(curve.off, float(np.max(np.abs(seen.off[fits]), initial=0.0)), _longest(curve, rest[~found]) / 2)
        waiting[piece[fits]], waiting[rest[~found]] = False, False
        more = np.concatenate([piece[fits], rest[found]])
        there = _joined(seen.some(fits), _looked_at(moved[found], slopes))
        curve, waiting = _with_more(replace(curve, off=off), waiting, more, there)
    return replace(curve, off=max(curve.off, _longest(curve, np.flatnonzero(waiting)) / 2))


def curve_tangents(at: Complex, slopes: Slopes) -> Complex:
    """Directions of borders at points on them, of length one, what is stable on the left hand, shape (points,)."""
    return _looked_at(at, slopes).tangents


def _apart(points: Complex) -> Complex:
    """Points without those that are as good as the one before, or as the last one."""
    kept = np.append(True, np.abs(np.diff(points)) > _SAME)
    if not kept[-1] and np.count_nonzero(kept) > 1:
        kept[np.flatnonzero(kept)[-1]], kept[-1] = False, True
    return points[kept]


@dataclass(frozen=True)
class _Seen:
    """What is at points near a border, each of shape (points,).

    Attributes:
        off: how far they are off it, along ∇e.
        points: on it, as far as Newton's next step goes.
        tangents, roots, turning: see BorderCurve.
    """

    off: Complex
    points: Complex
    tangents: Complex
    roots: Complex
    turning: Array

    def some(self, which: Flags) -> _Seen:
        """Some of the points."""
        return _Seen(self.off[which], self.points[which], self.tangents[which], self.roots[which], self.turning[which])


def _joined(first: _Seen, second: _Seen) -> _Seen:
    """Points of one after those of the other."""
    return _Seen(
        np.append(first.off, second.off),
        np.append(first.points, second.points),
        np.append(first.tangents, second.tangents),
        np.append(first.roots, second.roots),
        np.append(first.turning, second.turning),
    )


def _looked_at(at: Complex, slopes: Slopes) -> _Seen:
    root, along_x, along_y = slopes(at)
    excess = np.abs(root) ** 2 - 1
    gradient = 2 * ((np.conj(root) * along_x).real + 1j * (np.conj(root) * along_y).real)
    steep = np.maximum(np.abs(gradient), 1e-300)
    with np.errstate(invalid="ignore"):  # NaN where there is no matrix
        tangents = 1j * gradient / steep
        off = np.where(np.abs(excess) <= _ROUNDING, 0.0, excess) * gradient / steep**2
        turning = ((along_x * tangents.real + along_y * tangents.imag) / root).imag
    return _Seen(off, at - off, tangents, root - along_x * off.real - along_y * off.imag, turning)


def _lean(chord: Complex, tangents: Complex) -> Array:
    """Cosines between directions."""
    return (np.conj(chord) * tangents).real / np.abs(chord)


def _longest(curve: BorderCurve, piece: NDArray[np.intp]) -> float:
    return float(np.max(np.abs(curve.points[piece + 1] - curve.points[piece]), initial=0.0))


def _with_more(curve: BorderCurve, waiting: Flags, piece: NDArray[np.intp], more: _Seen) -> tuple[BorderCurve, Flags]:
    """The curve with one point more in some of its pieces."""
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
    """Points of the border in pieces: by Newton's method along ∇e, or between both sides of the piece's middle.

    NaN where neither finds one.
    """
    start, chord = curve.points[piece], curve.points[piece + 1] - curve.points[piece]
    at, off = near.copy(), np.full(len(near), np.inf)
    for _ in range(_MOVES):
        going = np.flatnonzero(np.abs(off) > WANTED / 10)
        if len(going) == 0:
            break
        step = _looked_at(at[going], slopes).off
        at[going], off[going] = at[going] - step, np.abs(step)
    share = (at - start) / chord
    lost = np.flatnonzero(
        ~(off <= WANTED / 10)
        | (np.abs(share.real - 0.5) > 0.3)
        | (np.abs(share.imag) > 0.3)
        | (_lean(chord, _looked_at(at, slopes).tangents) < _LEAN)
    )
    for wide in _WIDE:
        lost = lost[~_between_both_sides(at, lost, start[lost], chord[lost], wide, slopes)]
    at[lost] = np.nan
    return at


def _between_both_sides(
    at: Complex, which: NDArray[np.intp], start: Complex, chord: Complex, wide: float, slopes: Slopes
) -> Flags:
    """Put points where the border crosses the line across the middle of pieces; which of them it crosses there."""

    def excess(some: NDArray[np.intp], share: Array) -> Array:
        across = start[some] + chord[some] * (0.5 + 1j * wide * (1 - 2 * share))
        return np.abs(slopes(across)[0]) ** 2 - 1

    every = np.arange(len(which))
    left, right = (excess(every, np.full(len(which), share)) for share in (0.0, 1.0))
    crossed = np.flatnonzero((left < 0) & (right >= 0))
    found = roots(lambda some, share: excess(crossed[some], share), left[crossed], right[crossed])
    at[which[crossed]] = start[crossed] + chord[crossed] * (0.5 + 1j * wide * (1 - 2 * found))
    return np.isin(every, crossed)
