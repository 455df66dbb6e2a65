# pyright: strict
"""A map in rectangles: on each the half-turn matrices are interpolated, then only eigenvalues are left for a point."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.stability.floquet.lanes import multipliers_of_row
from dynamics.stability.floquet.matrix_surface import MatrixSurface, fit_surface, nodes_needed
from dynamics.stability.map_points import MapPoints

_MOST_NODES = 48  # along a side; more: two rectangles cost less
_WORTH = 3.0  # points that one node's matrix costs as much as
_ROWS = 8  # of a rectangle, that a thread takes at a time
_WANTED = 2e-14  # of the matrices' norm: rounding
_NODE_ERROR = 2e-13  # of a node's matrix: (rate × span) · (rate × step)^8 times …
_STEP_ERROR = 1e-7  # … this, measured on the nominal rig at Ω = 0.3 … 5, K = 1 … 16 against 256 steps


@dataclass(frozen=True)
class Rectangle:
    """A part of a map whose matrices are interpolated.

    Attributes:
        columns, rows: indices into the map's speed and stiffness ratios.
        surface: over s = 1/Ω and r = √K.
        units: of its matrices, shape (8,).
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    surface: MatrixSurface
    units: NDArray[np.floating]


class MapTiles:
    """Rectangles that cover as much of a map as is worth it.

    Args:
        parameters, angles: see MapPoints.
        speed_ratios, stiffness_ratios: of the map, shapes (n,) and (m,), in any order.
    """

    def __init__(
        self,
        parameters: RotorParameters,
        angles: tuple[float, float],
        speed_ratios: NDArray[np.floating],
        stiffness_ratios: NDArray[np.floating],
    ) -> None:
        self._parameters, self._angles = parameters, angles
        self._speeds, self._stiffness = speed_ratios, stiffness_ratios
        self._s, self._r = 1.0 / speed_ratios, np.sqrt(stiffness_ratios)
        self._swing = max(1.0, 2 * parameters.zeta1, 2 * parameters.zeta2)  # of a suspension's mode over its frequency
        losses, inertias = parameters.packed()[10:12], parameters.packed()[8:10]
        rates = np.divide(losses, inertias, out=np.zeros(2), where=inertias > 0)
        self._pendulums = float(np.max(rates)) / parameters.natural_frequencies_rad_s[0]

    def rectangles(self, pool: ThreadPoolExecutor) -> Iterator[Rectangle]:
        """The rectangles, one after the other."""
        if not (self._parameters.a.present and self._parameters.b.present):
            return
        yield from self._within(pool, np.argsort(self._s), np.argsort(self._r))

    def _rates(self, s: float, r: float) -> tuple[float, float]:
        """Fastest rates of the suspension and of the pendulums per radian of phase."""
        return max(1.0, r) * self._swing * s, self._pendulums * s

    def _half_phases(self, s: tuple[float, float], r: tuple[float, float]) -> tuple[float, float]:
        """Half of what the fastest mode turns, or decays, over a rectangle along s and along r, rad."""
        return np.pi / 2 * max(self._rates(s[1] - s[0], r[1])), np.pi / 2 * self._swing * s[1] * (r[1] - r[0])

    def _within(
        self, pool: ThreadPoolExecutor, columns: NDArray[np.intp], rows: NDArray[np.intp]
    ) -> Iterator[Rectangle]:
        """Rectangles within sorted columns and rows."""
        s, r = _span(self._s[columns]), _span(self._r[rows])
        phases = self._half_phases(s, r)
        n_s, n_r = nodes_needed(s, phases[0]), nodes_needed(r, phases[1])
        if _WORTH * min(n_s, 16) * min(n_r, 16) > len(columns) * len(rows):
            return
        if max(n_s, n_r) > _MOST_NODES:
            if n_s >= n_r:
                cut = int(np.searchsorted(self._s[columns], sum(s) / 2))
                parts = [(columns[:cut], rows), (columns[cut:], rows)]
            else:
                cut = int(np.searchsorted(self._r[rows], sum(r) / 2))
                parts = [(columns, rows[:cut]), (columns, rows[cut:])]
            for some_columns, some_rows in parts:
                if len(some_columns) and len(some_rows):
                    yield from self._within(pool, some_columns, some_rows)
            return
        if _WORTH * n_s * n_r > len(columns) * len(rows):
            return
        corner = MapPoints(self._parameters, self._angles, np.array([1.0 / s[1]]), np.array([r[1] ** 2]))
        swing = np.pi * max(1.0, *self._rates(s[1], r[1]))
        steps = math.ceil(max(8.0, swing * (_STEP_ERROR * swing / _NODE_ERROR) ** (1 / 8)))

        def matrices_at(s: NDArray[np.floating], r: NDArray[np.floating], finer: bool) -> NDArray[np.floating]:
            points = MapPoints(self._parameters, self._angles, 1.0 / s, r**2)
            return points.half_turns(pool, corner.units, 3 * steps // 2 if finer else steps)

        surface = fit_surface(matrices_at, s, r, phases, _WANTED)
        if surface is not None:
            yield Rectangle(columns, rows, surface, corner.units)

    def multipliers(
        self, pool: ThreadPoolExecutor, rectangle: Rectangle
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.floating], NDArray[np.floating]]]:
        """Rows, columns, largest multipliers and bounds, shape (rows, columns), of a rectangle, in parts."""
        surface, columns = rectangle.surface, rectangle.columns
        weights = surface.weights_s(self._s[columns])
        n_r, n_s = surface.nodes.shape[:2]
        nodes = surface.nodes.reshape(n_r, -1)

        def some(rows: NDArray[np.intp]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
            matrices = (surface.weights_r(self._r[rows]) @ nodes).reshape(len(rows), n_s, -1)
            found, errors = np.empty((len(rows), len(columns))), np.empty((len(rows), len(columns)))
            for i, row in enumerate(rows):
                points = MapPoints(
                    self._parameters, self._angles, self._speeds[columns], np.full(len(columns), self._stiffness[row])
                )
                multipliers_of_row(
                    matrices[i], weights, rectangle.units, points.rigs, points.length_m,
                    self._parameters.total_mass_kg, surface.error, found[i], errors[i],
                )  # fmt: skip
            return found, errors

        parts = np.array_split(rectangle.rows, -(-len(rectangle.rows) // _ROWS))
        pending = {pool.submit(some, rows): rows for rows in parts}
        for future in as_completed(pending):
            yield pending[future], columns, *future.result()


def _span(values: NDArray[np.floating]) -> tuple[float, float]:
    """First and last of sorted values."""
    return float(values[0]), float(values[-1])
