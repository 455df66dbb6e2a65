"""Reproducible division of a grid into nearly equal rectangles."""

from __future__ import annotations

from itertools import pairwise

Part = tuple[slice, slice]
"""Rows and columns of a grid."""


def parts_of(columns: int, rows: int, max_columns: int, max_points: int) -> list[Part]:
    """Return the rectangles of a grid, row by row.

    Args:
        columns, rows: points of the grid.
        max_columns: largest number of columns of a rectangle.
        max_points: approximate largest number of points of a rectangle.
    """
    across = _cuts(columns, -(-columns // max_columns))
    wide = max(part.stop - part.start for part in across)
    up = _cuts(rows, min(rows, -(-rows * wide // max_points)))
    return [(some_rows, some_columns) for some_rows in up for some_columns in across]


def _cuts(count: int, parts: int) -> list[slice]:
    """Divide a range into nearly equal parts."""
    return [slice(a, b) for a, b in pairwise(count * i // parts for i in range(parts + 1))]
