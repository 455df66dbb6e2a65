"""Crossings of stability borders with the sides of a grid's cells, located to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Flags
from dynamics.stability.border_cells import BorderCells, Excess, Integers, Lattice

_ROUNDS = 80
_NARROW = 1e-13  # accuracy of a crossing's position, relative to the side

# Side k leads from corner k to corner k + 1, anticlockwise: lower point of the side from that of the cell; vertical
_SIDE_I, _SIDE_J = np.array([0, 1, 0, 0]), np.array([0, 0, 1, 0])
_UPRIGHT = np.array([0, 1, 0, 1])


@dataclass(frozen=True)
class Crossings:
    """Crossings of borders with a grid's sides.

    Attributes:
        columns, rows: positions in units of cells, shape (n,); one of the two is an integer.
        stable_share: stable fraction of the area of each given cell, shape (cells,).
    """

    columns: Array
    rows: Array
    stable_share: Array


def crossings_of(lattice: Lattice, cells: BorderCells, excess: Excess) -> Crossings:
    """Locate every crossing of the sides of the cells."""
    below = cells.excess < 0
    crossed = below != np.roll(below, -1, axis=1)
    keys = ((cells.i[:, None] + _SIDE_I) * (lattice.rows + 1) + cells.j[:, None] + _SIDE_J) * 2 + _UPRIGHT
    sides = np.unique(keys[crossed])
    if len(sides) == 0:
        nothing = np.empty(0)
        return Crossings(nothing, nothing, nothing)
    i, j, upright, share = _located(lattice, sides, cells, keys, excess)
    number = np.minimum(np.searchsorted(sides, keys), len(sides) - 1)
    columns, rows = np.where(upright, 0.0, share) + i, np.where(upright, share, 0.0) + j
    return Crossings(np.asarray(columns, float), np.asarray(rows, float), _stable_shares(below, crossed, share[number]))


def _located(
    lattice: Lattice, sides: Integers, cells: BorderCells, keys: Integers, excess: Excess
) -> tuple[Integers, Integers, Flags, Array]:
    """Lower points of sides, whether they are vertical, and the position of the crossing on them, 0 … 1.

    The Illinois method runs on all sides at once, with a bisection every fourth iteration.
    """
    places, upright = np.divmod(sides, 2)
    i, j = np.divmod(places, lattice.rows + 1)
    at_lower, at_upper = _ends_of_sides(sides, cells, keys)
    tall = upright.astype(bool)

    def along(which: NDArray[np.intp], share: Array) -> Array:
        up = tall[which]
        return excess(lattice.x(i[which] + np.where(up, 0.0, share)), lattice.y(j[which] + np.where(up, share, 0.0)))

    return i, j, tall, roots(along, at_lower, at_upper)


def _ends_of_sides(sides: Integers, cells: BorderCells, keys: Integers) -> tuple[Array, Array]:
    """The excess at the lower and the upper point of each side, shape (sides,) each."""
    lower, upper = np.empty(len(sides)), np.empty(len(sides))
    for k in range(4):
        place = np.searchsorted(sides, keys[:, k])
        there = (place < len(sides)) & (sides[np.minimum(place, len(sides) - 1)] == keys[:, k])
        first, second = (k, (k + 1) % 4) if k < 2 else ((k + 1) % 4, k)  # sides 2 and 3 lead downwards
        lower[place[there]], upper[place[there]] = cells.excess[there, first], cells.excess[there, second]
    return lower, upper


def roots(function: Callable[[NDArray[np.intp], Array], Array], low: Array, high: Array) -> Array:
    """Roots in 0 … 1 of many functions whose values at the ends have different signs."""
    a, b, fa, fb = np.zeros(len(low)), np.ones(len(low)), low.copy(), high.copy()
    root = np.where(fa == 0, a, b)
    going = np.flatnonzero((fa != 0) & (fb != 0))
    for turn in range(_ROUNDS):
        if len(going) == 0:
            break
        halve = turn % 4 == 3
        inner = (a[going] * fb[going] - b[going] * fa[going]) / (fb[going] - fa[going])
        at = np.where(halve | ~np.isfinite(inner), (a[going] + b[going]) / 2, inner)
        value = function(going, at)
        root[going] = at
        same = np.sign(value) == np.sign(fb[going])
        keeps_b, keeps_a = going[~same], going[same]
        a[keeps_b], fa[keeps_b] = b[keeps_b], fb[keeps_b]
        fa[keeps_a] *= 0.5
        b[going], fb[going] = at, value
        done = (value == 0) | (np.abs(b[going] - a[going]) <= _NARROW)
        going = going[~done]
    return root


def _stable_shares(below: Flags, crossed: Flags, share: Array) -> Array:
    """Area of the stable polygon in each cell, corners and crossings joined by straight lines, shape (cells,)."""
    along = np.where(np.arange(4) < 2, share, 1 - share)
    x = _SIDES_X[:, :1].T, (_SIDES_X[:, :1] + (_SIDES_X[:, 1:] * along.T)).T
    y = _SIDES_Y[:, :1].T, (_SIDES_Y[:, :1] + (_SIDES_Y[:, 1:] * along.T)).T
    kept = np.stack([below, crossed], axis=2).reshape(len(below), 8)
    px, py = (np.stack([np.broadcast_to(a, along.shape), b], axis=2).reshape(len(below), 8) for a, b in (x, y))
    for _ in range(8):  # an absent point is replaced by the one before it
        px, py = (np.where(kept, part, np.roll(part, 1, axis=1)) for part in (px, py))
    return np.sum(px * np.roll(py, -1, axis=1) - py * np.roll(px, -1, axis=1), axis=1) / 2


_SIDES_X = np.array([[0.0, 1.0], [1.0, 0.0], [1.0, -1.0], [0.0, 0.0]])  # start and direction of each side
_SIDES_Y = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, -1.0]])
