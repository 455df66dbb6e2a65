# pyright: strict
"""How much of a plane is stable, and of how much the borders say nothing."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from analysis.maps.axes import MapAxis
from dynamics.stability.borders import Borders
from dynamics.stability.map_plane import Plane


def unresolved_share(plane: Plane, borders: Borders, axes: tuple[MapAxis, MapAxis]) -> float:
    """Share of the plane in which a balanced state exists, but no border was looked for.

    There the matrix cannot be interpolated: pendulums damped so much that they creep, for example. The borders' stable
    share counts it as not stable. A rectangle counts whole, by its middle.
    """
    lost = 0.0
    for spans in borders.bare:
        sides = list[tuple[float, float]]()
        for span, coordinate in zip(spans, (plane.x, plane.y), strict=True):
            first, last = np.sort(coordinate.back(np.array(span))).tolist()
            sides.append((first, last))
        middle = [np.array([0.5 * (low + high)]) for low, high in sides]
        rigs = plane.rigs(*middle)
        if rigs is None or not np.isnan(rigs.theta_rad).any():
            lost += math.prod(_part(axis, *side) for axis, side in zip(axes, sides, strict=True))
    return min(lost, 1.0)


def _part(axis: MapAxis, low: float, high: float) -> float:
    """Which share of an axis lies between two values."""
    of: Callable[[float], float] = math.log if axis.logarithmic else float
    first, last = axis.span
    inside = of(min(high, last)) - of(max(low, first))
    return max(inside, 0.0) / (of(last) - of(first))
