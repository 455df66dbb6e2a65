"""Refinement of a map where its class changes: a coarse grid, with finer grids only along the borders of classes.

Claim: on the finest grid the classes are those of the full grid, except for islands without a computed point. Proof:
let a point that was not computed have the wrong class. The corners of the cells around it all have the class a that the
point was given; otherwise they and the point would have been computed. So every wrong point that touches it, and every
correct point that touches the patch of wrong ones, was given a too: the patch is surrounded by a, and no point of it
was computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array, Indices


@dataclass(frozen=True)
class RefinedGrid:
    """Values on the finest grid.

    Attributes:
        values: shape (m, n); values that are not `computed` follow from the coarser grid (means, or with
            `interpolated` False those of a neighbour of the same class).
        computed: whether each point was evaluated, shape (m, n).
    """

    values: Array
    computed: NDArray[np.bool_]


def refined_grid(
    evaluate: Callable[[Array, Array], Array],
    x: Array,
    y: Array,
    levels: int,
    classes: Callable[[Array], Indices],
    *,
    interpolated: bool = True,
    progress: Callable[[float], None] | None = None,
) -> RefinedGrid:
    """Evaluate a coarse grid, and halve its cells in both directions where the classes of their corners differ.

    At each level, all corners of every cell of the new grid whose corners differ (evaluated or interpolated) are
    evaluated, until no such cell remains. A border that leaves a cell is thereby followed into cells whose corners had
    equal classes. **Missed at the finest grid** are only areas of one class that touch neither an evaluated point nor
    another border: islands between the points of the coarse grid. Everything else is as on the full grid.

    Args:
        evaluate: returns values at points, (points,) and (points,) to (points,); NaN where no value exists.
        x, y: finest grid, shapes (n,) and (m,) with n − 1 and m − 1 multiples of 2**levels.
        levels: number of halvings.
        classes: returns the classes of values, any shape.
        interpolated: whether values may be averaged; False for class numbers.
        progress: called with the completed share, as far as it can be estimated.
    Raises:
        ValueError: the sizes are not such multiples.
    """
    stride = 1 << levels
    if (len(x) - 1) % stride or (len(y) - 1) % stride or len(x) < 2 or len(y) < 2:
        raise ValueError(f"expected {stride} k + 1 points a side, k ≥ 1, got {len(x)} and {len(y)}")
    notify = progress or _ignore
    at = _Level(x[::stride], y[::stride], evaluate, classes)
    at.compute(np.ones(at.values.shape, bool))
    for level in range(levels):
        notify((1 + level) / (2 + levels))
        at = at.halved(x[:: stride >> level + 1], y[:: stride >> level + 1], interpolated)
    notify(1.0)
    return RefinedGrid(at.values, at.computed)


class _Level:
    """One grid with its known values."""

    def __init__(
        self, x: Array, y: Array, evaluate: Callable[[Array, Array], Array], classes: Callable[[Array], Indices]
    ) -> None:
        self.x, self.y = x, y
        self.values = np.full((len(y), len(x)), np.nan)
        self.computed = np.zeros((len(y), len(x)), bool)
        self._evaluate, self._classes = evaluate, classes

    def compute(self, wanted: NDArray[np.bool_]) -> bool:
        """Evaluate the wanted points that are not computed yet; return whether there were any."""
        rows, columns = np.nonzero(wanted & ~self.computed)
        if len(rows) == 0:
            return False
        self.values[rows, columns] = self._evaluate(self.x[columns], self.y[rows])
        self.computed[rows, columns] = True
        return True

    def corners_that_differ(self) -> NDArray[np.bool_]:
        """Return the corners of cells whose corners differ in class, shape (m, n)."""
        found = self._classes(self.values)
        first = found[:-1, :-1]
        cells = (first != found[1:, :-1]) | (first != found[:-1, 1:]) | (first != found[1:, 1:])
        corners = np.zeros(found.shape, bool)
        for rows in (slice(None, -1), slice(1, None)):
            for columns in (slice(None, -1), slice(1, None)):
                corners[rows, columns] |= cells
        return corners

    def halved(self, x: Array, y: Array, interpolated: bool) -> _Level:
        """Return the next grid, evaluated where classes change."""
        fine = _Level(x, y, self._evaluate, self._classes)
        v = self.values
        fine.values[::2, ::2], fine.computed[::2, ::2] = v, self.computed
        between = _mean if interpolated else _first
        fine.values[::2, 1::2] = between(v[:, :-1], v[:, 1:])
        fine.values[1::2, ::2] = between(v[:-1], v[1:])
        fine.values[1::2, 1::2] = between(between(v[:-1, :-1], v[:-1, 1:]), between(v[1:, :-1], v[1:, 1:]))
        found = self._classes(v)
        first = found[:-1, :-1]
        cells = (first != found[1:, :-1]) | (first != found[:-1, 1:]) | (first != found[1:, 1:])
        wanted = np.zeros(fine.values.shape, bool)
        for row in range(3):
            for column in range(3):
                wanted[row : row + 2 * cells.shape[0] - 1 : 2, column : column + 2 * cells.shape[1] - 1 : 2] |= cells
        fine.compute(wanted)
        while fine.compute(fine.corners_that_differ()):
            pass
        return fine


def _mean(a: Array, b: Array) -> Array:
    return a + 0.5 * (b - a)


def _first(a: Array, b: Array) -> Array:
    del b
    return a


def _ignore(share: float) -> None:
    del share
