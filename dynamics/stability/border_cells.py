"""Cells of a plane that contain a border of stability: a coarse grid whose cells are halved near possible borders.

A cell counts as clear if the excess e = max|μ| − 1 at each of its corners is farther from zero than the corners' values
are from each other. A border, an island or a band is therefore missed only if it lies within one cell and the
multipliers at the corners do not indicate it. The fineness of the first grid decides this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Complex, Flags

Integers = NDArray[np.int64]
Excess = Callable[[Array, Array], Array]
"""max|μ| − 1 at x and y, shape (points,) each; NaN where the balanced state does not exist."""

_MAX_SPREAD_RATIO = 2.0  # largest ratio of the nearest corner's |e| to the corners' spread in a cell that is halved


@dataclass(frozen=True)
class Lattice:
    """Points of the finest grid over a range.

    Attributes:
        x_range, y_range: lower and upper limits.
        columns, rows: numbers of cells of the finest grid along x and y.
        logarithmic: whether x, and whether y, is spaced evenly in its logarithm.
    """

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    columns: int
    rows: int
    logarithmic: tuple[bool, bool] = (False, False)

    def x(self, i: Integers | Array) -> Array:
        """Values of x on columns of points; fractional columns are permitted."""
        return _between(self.x_range, np.asarray(i, float) / self.columns, self.logarithmic[0])

    def y(self, j: Integers | Array) -> Array:
        """Values of y on rows of points; fractional rows are permitted."""
        return _between(self.y_range, np.asarray(j, float) / self.rows, self.logarithmic[1])

    def places(self, at: Complex) -> tuple[Array, Array]:
        """x and y of points of the unit square that represents the range."""
        return self.x(at.real * self.columns), self.y(at.imag * self.rows)

    def place(self, at: complex) -> tuple[float, float]:
        """x and y of one point of the unit square."""
        return float(self.x(np.array(at.real * self.columns))), float(self.y(np.array(at.imag * self.rows)))


def _between(span: tuple[float, float], share: Array, logarithmic: bool) -> Array:
    """Values at a fraction of the range; the last one is exact."""
    low, high = span
    inner = low * (high / low) ** share if logarithmic else low + (high - low) * share
    return np.where(share == 1.0, high, inner)


class KnownPoints:
    """The excess at points of a lattice. Each point is computed once."""

    def __init__(self, lattice: Lattice, excess: Excess) -> None:
        self._lattice, self._excess = lattice, excess
        self._keys, self._values = np.empty(0, np.int64), np.empty(0)

    def __len__(self) -> int:
        return len(self._keys)

    def at(self, i: Integers, j: Integers) -> Array:
        """The excess at points of the lattice, in the shape of the indices."""
        keys = i * (self._lattice.rows + 1) + j
        new = np.setdiff1d(keys.ravel(), self._keys)
        if len(new):
            columns, rows = np.divmod(new, self._lattice.rows + 1)
            found = self._excess(self._lattice.x(columns), self._lattice.y(rows))
            order = np.argsort(all_keys := np.concatenate([self._keys, new]), kind="stable")
            self._keys, self._values = all_keys[order], np.concatenate([self._values, found])[order]
        return self._values[np.searchsorted(self._keys, keys)]


@dataclass(frozen=True)
class BorderCells:
    """Cells of the finest grid with a sign change.

    Attributes:
        i, j: lower left corners, shape (cells,).
        excess: values at the corners, anticlockwise from the lower left one, shape (cells, 4).
        clear_stable: fraction of the range in cells that are entirely stable.
    """

    i: Integers
    j: Integers
    excess: Array
    clear_stable: float


def border_cells(
    known: KnownPoints, columns: int, rows: int, levels: int, progress: Callable[[float], None]
) -> BorderCells:
    """Find the cells that contain a border.

    Args:
        known: points of a lattice of columns · 2^levels × rows · 2^levels cells.
        columns, rows: numbers of cells of the first grid.
        levels: number of halvings of a cell in both directions.
        progress: called with the completed share, 0 … 1.
    """
    size, stable = 2**levels, 0.0
    grid = np.meshgrid(np.arange(columns, dtype=np.int64), np.arange(rows, dtype=np.int64), indexing="ij")
    i, j = (part.ravel() * size for part in grid)
    while True:
        excess = _corners(known, i, j, size)
        finite = np.isfinite(excess)
        below = finite.all(axis=1) & np.all(excess < 0, axis=1)
        share = size * size / (columns * rows * 4**levels)
        if size == 1:
            cut = finite.all(axis=1) & ~below & np.any(excess < 0, axis=1)
            return BorderCells(i[cut], j[cut], excess[cut], stable + share * int(np.count_nonzero(below)))
        open_cells = _can_contain_a_border(excess, finite)
        stable += share * int(np.count_nonzero(below & ~open_cells))
        size //= 2
        i = np.concatenate([i[open_cells] + a * size for a, _ in _QUARTERS])
        j = np.concatenate([j[open_cells] + b * size for _, b in _QUARTERS])
        progress(1 - size / 2**levels)


_QUARTERS = ((0, 0), (1, 0), (0, 1), (1, 1))
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # anticlockwise


def _corners(known: KnownPoints, i: Integers, j: Integers, size: int) -> Array:
    """The excess at the corners of cells, anticlockwise from the lower left one, shape (cells, 4)."""
    steps = _CORNERS * size
    return known.at(i[:, None] + steps[:, 0], j[:, None] + steps[:, 1])


def _can_contain_a_border(excess: Array, finite: Flags) -> Flags:
    """Cells whose corners are not clearly on one side, and cells in which the balanced state ceases to exist."""
    whole = np.all(finite, axis=1)
    spread = np.ptp(np.where(finite, excess, 0.0), axis=1)
    nearest = np.min(np.where(finite, np.abs(excess), np.inf), axis=1)
    return (whole & (nearest <= _MAX_SPREAD_RATIO * spread)) | (np.any(finite, axis=1) & ~whole)
