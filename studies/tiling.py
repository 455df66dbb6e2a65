# pyright: strict
"""A grid cut into nearly equal rectangles: the same ones wherever it is cut."""

from __future__ import annotations

from itertools import pairwise

Part = tuple[slice, slice]
"""Rows and columns of a grid."""


def parts_of(columns: int, rows: int, widest: int, most: int) -> list[Part]:
    """The rectangles of a grid, row by row.

    Args:
        columns, rows: points of the grid.
        widest: columns of a rectangle, at most.
        most: points of a rectangle, about, at most.
    """
    across = _cuts(columns, -(-columns // widest))
    wide = max(part.stop - part.start for part in across)
    up = _cuts(rows, min(rows, -(-rows * wide // most)))
    return [(some_rows, some_columns) for some_rows in up for some_columns in across]


def _cuts(count: int, parts: int) -> list[slice]:
    """Nearly equal parts."""
    return [slice(a, b) for a, b in pairwise(count * i // parts for i in range(parts + 1))]
