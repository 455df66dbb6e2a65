"""Stable share of a plane, and share that the borders leave undecided."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from analysis.maps.axes import MapAxis
from dynamics.stability.borders import Borders
from dynamics.stability.map_plane import Plane


def unresolved_share(plane: Plane, borders: Borders, axes: tuple[MapAxis, MapAxis]) -> float:
    """Return the share of the plane in which a balanced state exists but no border was searched.

    The matrix cannot be interpolated there, for example if pendulums creep because of strong damping. The stable share
    of the borders counts this area as not stable. A rectangle counts as a whole, by its middle.
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
    """Return the share of an axis between two values."""
    of: Callable[[float], float] = math.log if axis.logarithmic else float
    first, last = axis.span
    inside = of(min(high, last)) - of(max(low, first))
    return max(inside, 0.0) / (of(last) - of(first))
