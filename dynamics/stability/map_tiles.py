"""A map in rectangles: half-turn matrices are interpolated on each, so that a point needs only its eigenvalues."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array
from dynamics.stability.floquet.lanes import NUMBERS, half_turn_matrices
from dynamics.stability.floquet.matrix_rows import multipliers_of_rows
from dynamics.stability.floquet.matrix_surface import MatrixSurface, fit_surface, nodes_needed
from dynamics.stability.map_plane import Plane
from dynamics.stability.map_points import half_turns
from dynamics.stability.map_rigs import MapRigs
from rig_basics.arrays import Indices

MAX_NODES = 40  # along a side; for more, two rectangles are cheaper
_MIN_NODES = 16
_WORTH = 3.0  # cost of a node's matrix, in points
_ROWS = 8  # number of rows of a rectangle per task
_WANTED = 3e-14  # relative to the matrices' norm
_NODE_ERROR = 2e-13  # of a node's matrix: (rate × span) · (rate × step)^8 times …
_STEP_ERROR = 1e-7  # … this constant, measured on the nominal rig at Ω = 0.3 … 5, K = 1 … 16 against 256 steps
_MAX_STEPS = 1024

Span = tuple[float, float]


@dataclass(frozen=True)
class Rectangle:
    """Part of a map with interpolated matrices.

    Attributes:
        columns, rows: indices into the map's values of x and y.
        surface: matrices over the coordinates of x and y.
    """

    columns: Indices
    rows: Indices
    surface: MatrixSurface


def needed_nodes(plane: Plane, u_range: Span, v_range: Span) -> tuple[int, int] | None:
    """Expected numbers of nodes of a rectangle along u and v; None if a pendulum is absent."""
    corners = _corners(plane, u_range, v_range)
    if corners is None:
        return None
    along_u, along_v = _half_phases(corners)
    return nodes_needed(u_range, along_u), nodes_needed(v_range, along_v)


def surface_over(pool: ThreadPoolExecutor, plane: Plane, u_range: Span, v_range: Span) -> MatrixSurface | None:
    """The matrices over a rectangle; None if they are not smooth or need too many steps."""
    corners = _corners(plane, u_range, v_range)
    if corners is None:
        return None
    units = np.max(corners.units, axis=0)
    swing = np.pi * max(1.0, float(np.max(corners.swings)), float(np.max(corners.fades)))
    if not swing < _MAX_STEPS:
        return None
    steps = math.ceil(max(8.0, swing * (_STEP_ERROR * swing / _NODE_ERROR) ** (1 / 8)))
    if steps > _MAX_STEPS:
        return None

    def matrices_at(u: Array, v: Array, finer: bool) -> Array:
        rigs = plane.rigs(plane.x.back(u), plane.y.back(v))
        if rigs is None or np.any(np.isnan(rigs.theta_rad)):
            return np.full((len(u), 8, 8), np.nan)
        return half_turns(pool, rigs, units, 3 * steps // 2 if finer else steps)

    return fit_surface(matrices_at, u_range, v_range, _half_phases(corners), _WANTED)


def _corners(plane: Plane, u_range: Span, v_range: Span) -> MapRigs | None:
    """Rigs at the corners of a rectangle; u varies first."""
    return plane.rigs(plane.x.back(np.tile(u_range, 2)), plane.y.back(np.repeat(v_range, 2)))


class MapTiles:
    """Rectangles that cover the part of a map for which interpolation reduces the work.

    Args:
        plane: plane of the map.
        x, y: values of the map, shapes (n,) and (m,), in any order.
    """

    def __init__(self, plane: Plane, x: Array, y: Array) -> None:
        self._plane = plane
        self._u, self._v = plane.x.of(x), plane.y.of(y)

    def rectangles(self, pool: ThreadPoolExecutor) -> Iterator[Rectangle]:
        """Generate the rectangles."""
        yield from self._within(pool, np.argsort(self._u), np.argsort(self._v))

    def _within(self, pool: ThreadPoolExecutor, columns: Indices, rows: Indices) -> Iterator[Rectangle]:
        """Generate rectangles within sorted columns and rows."""
        points = len(columns) * len(rows)
        if points < _WORTH * min(len(columns), _MIN_NODES) * min(len(rows), _MIN_NODES):
            return
        spans = _span(self._u[columns]), _span(self._v[rows])
        needed = needed_nodes(self._plane, *spans)
        if needed is None:
            return
        if max(needed) <= MAX_NODES:
            if points < _WORTH * needed[0] * needed[1]:
                return
            surface = surface_over(pool, self._plane, *spans)
            if surface is not None:
                yield Rectangle(columns, rows, surface)
                return
        if needed[0] >= needed[1]:
            halves = _halves(self._u, columns)
            parts = [(half, rows) for half in halves]
        else:
            halves = _halves(self._v, rows)
            parts = [(columns, half) for half in halves]
        if len(halves) == 2:
            for some_columns, some_rows in parts:
                yield from self._within(pool, some_columns, some_rows)

    def multipliers(
        self, pool: ThreadPoolExecutor, rectangle: Rectangle
    ) -> Iterator[tuple[Indices, Indices, Array, Array]]:
        """Generate rows, columns, largest multipliers and bounds, shape (rows, columns), of a rectangle, in parts."""
        surface, columns = rectangle.surface, rectangle.columns
        weights = surface.weights_u(self._u[columns])
        nodes = surface.nodes.reshape(*surface.nodes.shape[:2], -1)

        def some(rows: Indices) -> tuple[Array, Array]:
            found, errors = np.empty((len(rows), len(columns))), np.empty((len(rows), len(columns)))
            multipliers_of_rows(nodes, surface.weights_v(self._v[rows]), weights, surface.error, found, errors)
            return found, errors

        parts = np.array_split(rectangle.rows, -(-len(rectangle.rows) // _ROWS))
        pending = {pool.submit(some, rows): rows for rows in parts}
        for future in as_completed(pending):
            yield pending[future], columns, *future.result()


def compile_tiles() -> None:
    """Compile the functions that a map's rectangles call, so that compilation is not part of a map's time."""
    half_turn_matrices(2, np.ones((1, NUMBERS)), np.ones(8), np.empty((1, 8, 8)))
    one, found, errors = np.ones((1, 1)), np.empty((1, 1)), np.empty((1, 1))
    multipliers_of_rows(np.ones((1, 1, 64)), one, one, 0.0, found, errors)


def _half_phases(corners: MapRigs) -> tuple[float, float]:
    """Half the phase or decay of the fastest mode over a rectangle along u and along v, rad.

    Args:
        corners: rigs at the corners; u varies first.
    """
    rates = np.concatenate([np.pi * corners.swings, np.pi * corners.fades, corners.theta_rad]).reshape(-1, 2, 2)
    along_u, along_v = (float(np.nanmax(np.abs(np.diff(rates, axis=axis)), initial=0.0)) / 2 for axis in (2, 1))
    return along_u, along_v


def _span(values: Array) -> Span:
    """First and last of sorted values."""
    return float(values[0]), float(values[-1])


def _halves(values: Array, order: Indices) -> list[Indices]:
    """Sorted indices, split at the middle of their values; one part if all lie on one side."""

    low, high = _span(values[order])
    cut = int(np.searchsorted(values[order], (low + high) / 2))
    return [part for part in (order[:cut], order[cut:]) if len(part)]
