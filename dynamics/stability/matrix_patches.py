"""Eigenvalues of the half-turn matrix at any point of a range of a plane, from rectangles that cover the range."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex, Flags
from dynamics.stability.floquet.matrix_rows import eigenvalues_at, largest_eigenvalue_there
from dynamics.stability.floquet.matrix_slopes import largest_with_slopes
from dynamics.stability.floquet.matrix_surface import MatrixSurface
from dynamics.stability.map_plane import Plane
from dynamics.stability.map_tiles import MAX_NODES, needed_nodes, surface_over

_SLACK = 1e-12  # relative tolerance of a rectangle's sides
_BATCH = 512  # number of points per task
_SMALLEST = 1 / 64  # smallest side of a rectangle relative to the range; below it the matrix counts as not smooth

Span = tuple[float, float]
_Values = Callable[[MatrixSurface, Array, Array], Complex]


@dataclass(frozen=True)
class MatrixPatches:
    """Rectangles over a range.

    Attributes:
        plane: plane of the half-turn matrices.
        surfaces: one surface per rectangle. The rectangles share sides and do not cover `bare`.
        bare: rectangles (u and v from, to) in which the balanced state does not exist or the matrix is not smooth.
    """

    plane: Plane
    surfaces: tuple[MatrixSurface, ...]
    bare: tuple[tuple[Span, Span], ...]

    def eigenvalues(self, pool: ThreadPoolExecutor, x: Array, y: Array) -> Complex:
        """Eigenvalues of D Φ(π), whose squares are the multipliers, largest modulus first, shape (points, 8).

        NaN in bare rectangles.
        """
        return self._on_surfaces(pool, _values, 8, x, y)

    def with_slopes(self, pool: ThreadPoolExecutor, x: Array, y: Array) -> Complex:
        """The largest eigenvalue λ with ∂λ/∂u and ∂λ/∂v, u and v the plane's coordinates, shape (points, 3).

        Of a pair the one with Im λ ≥ 0; NaN in bare rectangles.
        """
        return self._on_surfaces(pool, _with_slopes, 3, x, y)

    def _on_surfaces(self, pool: ThreadPoolExecutor, values_of: _Values, count: int, x: Array, y: Array) -> Complex:
        """Results of a function at points, shape (points, count), each from the rectangle that contains the point."""
        u, v = self.plane.x.of(x), self.plane.y.of(y)
        found = np.full((len(u), count), np.nan, complex)
        open_points = np.ones(len(u), bool)
        for surface in self.surfaces:
            here = np.flatnonzero(open_points & _inside(surface.u_range, u) & _inside(surface.v_range, v))
            open_points[here] = False
            here = here[np.argsort(v[here], kind="stable")]
            parts = [here[start : start + _BATCH] for start in range(0, len(here), _BATCH)]
            pending = [pool.submit(values_of, surface, u[part], v[part]) for part in parts]
            for part, values in zip(parts, pending, strict=True):
                found[part] = values.result()
        return found

    def largest_there(self, x: float, y: float) -> complex:
        """The largest eigenvalue at a single point; NaN in bare rectangles."""
        u, v = (float(c.of(np.array(value))) for c, value in ((self.plane.x, x), (self.plane.y, y)))
        for surface in self.surfaces:
            shares = _share(surface.u_range, u), _share(surface.v_range, v)
            if max(abs(shares[0]), abs(shares[1])) <= 1.0 + _SLACK:
                nodes = surface.nodes.reshape(*surface.nodes.shape[:2], -1)
                return complex(largest_eigenvalue_there(nodes, *shares))
        return complex(np.nan, np.nan)


def cover(pool: ThreadPoolExecutor, plane: Plane, x_range: Span, y_range: Span) -> MatrixPatches:
    """Cover a range with rectangles.

    Args:
        x_range, y_range: limits in values of the plane's parameters, each with low < high.
    """
    u, v = (tuple(sorted(c.of(np.array(r)).tolist())) for c, r in ((plane.x, x_range), (plane.y, y_range)))
    surfaces: list[MatrixSurface] = []
    bare: list[tuple[Span, Span]] = []
    waiting = [((u[0], u[1]), (v[0], v[1]), 1.0, 1.0)]
    while waiting:
        u_range, v_range, u_share, v_share = waiting.pop()
        needed = needed_nodes(plane, u_range, v_range)
        if needed is not None and max(needed) <= MAX_NODES:
            surface = surface_over(pool, plane, u_range, v_range)
            if surface is not None:
                surfaces.append(surface)
                continue
        if min(u_share, v_share) <= _SMALLEST or _unbalanced(plane, u_range, v_range):
            bare.append((u_range, v_range))
            continue
        crowded = needed is not None and max(needed) > MAX_NODES
        along_u = needed[0] >= needed[1] if needed is not None and crowded else u_share >= v_share
        if along_u:
            waiting += [(half, v_range, u_share / 2, v_share) for half in _halves(u_range)]
        else:
            waiting += [(u_range, half, u_share, v_share / 2) for half in _halves(v_range)]
    return MatrixPatches(plane, tuple(surfaces), tuple(bare))


def _unbalanced(plane: Plane, u_range: Span, v_range: Span) -> bool:
    """Whether the balanced state exists at none of 25 points of a rectangle."""
    u, v = (part.ravel() for part in np.meshgrid(np.linspace(*u_range, 5), np.linspace(*v_range, 5)))
    rigs = plane.rigs(plane.x.back(u), plane.y.back(v))
    return rigs is not None and bool(np.all(np.isnan(rigs.theta_rad)))


def _halves(span: Span) -> tuple[Span, Span]:
    middle = (span[0] + span[1]) / 2
    return (span[0], middle), (middle, span[1])


def _share(span: Span, value: float) -> float:
    """Position of a value in the interval, −1 … 1."""
    return 0.0 if span[0] == span[1] else (2 * value - span[0] - span[1]) / (span[1] - span[0])


def _inside(span: Span, values: Array) -> Flags:
    slack = _SLACK * (abs(span[0]) + abs(span[1]))
    return (values >= span[0] - slack) & (values <= span[1] + slack)


def _values(surface: MatrixSurface, u: Array, v: Array) -> Complex:
    """Eigenvalues at points sorted by v, shape (points, n)."""
    rows, row = np.unique(v, return_inverse=True)
    nodes = surface.nodes.reshape(*surface.nodes.shape[:2], -1)
    values = np.empty((len(u), surface.nodes.shape[-1]), complex)
    eigenvalues_at(nodes, surface.weights_v(rows), np.asarray(row, np.intp), surface.weights_u(u), values)
    return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1), 1)


def _with_slopes(surface: MatrixSurface, u: Array, v: Array) -> Complex:
    """Largest eigenvalues at points with their derivatives, shape (points, 3)."""
    found = np.empty((len(u), 3), complex)
    weights = surface.weights_v(v), surface.slopes_v(v), surface.weights_u(u), surface.slopes_u(u)
    largest_with_slopes(surface.nodes.reshape(*surface.nodes.shape[:2], -1), *weights, found)
    return found
