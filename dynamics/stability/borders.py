"""Borders of stability as curves on which the largest multiplier of the balanced state has the modulus 1.

A grid whose cells are halved near possible borders gives the crossings of borders with the sides of its finest cells
(`border_cells`, `border_crossings`). Each border is followed from such a crossing with its own steps
(`border_following`), until every crossing lies on a border. Every crossing is therefore found, independent of the grid.
The result is a curve through the followed points that is exact between them too (`border_curves`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.errors import OutsideDomain
from dynamics.stability.border_cells import KnownPoints, Lattice, border_cells
from dynamics.stability.border_crossings import Crossings, crossings_of
from dynamics.stability.border_curves import BorderCurve, Slopes, curve_tangents, curve_through
from dynamics.stability.border_following import follow
from dynamics.stability.map_plane import Plane
from dynamics.stability.map_points import cores
from dynamics.stability.matrix_patches import MatrixPatches, cover
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

_FIRST = (192, 144)  # numbers of cells of the first grid
LEVELS = 1
"""Default number of halvings of the first grid."""
_SPACING = 1 / 4000
_STEP = 1e-6  # of the unit square: step for derivatives of the coordinates
_REAL = 1e-9  # |Im μ| below which a multiplier counts as real

Span = tuple[float, float]
DIVERGENCE, FLUTTER, DOUBLING = "divergence", "flutter", "period doubling"
"""Loss of stability: a multiplier leaves the unit circle at +1; a complex pair leaves it; one leaves it at −1."""


@dataclass(frozen=True)
class Border:
    """One branch.

    Attributes:
        x, y: points in order, shape (n,); the stable side is on the left. On a closed branch the first point is
            repeated at the end. Consecutive points are at most `spacing` apart. Straight lines between them therefore
            deviate from the border by less than half of that in any direction, and by about spacing²/8 over its radius.
        multiplier: multiplier that crosses the unit circle, of a pair the one with Im μ ≥ 0, complex, shape (n,).
        closed: whether the branch is an island. Otherwise both ends lie on the range's sides or where the balanced
            state ceases to exist.
        spacing: largest distance of points as a fraction of the range, on a logarithmic axis of its logarithm.
        curve: the branch in the unit square that represents the range.
        lattice: relation of the unit square to x and y.
    """

    x: Array
    y: Array
    multiplier: Complex
    closed: bool
    spacing: float
    curve: BorderCurve
    lattice: Lattice

    @classmethod
    def along(cls, curve: BorderCurve, lattice: Lattice, closed: bool, spacing: float) -> Border:
        """Branch with the points of a curve; see the class."""
        at, root = curve.between(spacing)
        return cls(*lattice.places(at), _upper(root**2), closed, spacing, curve, lattice)

    def at_spacing(self, spacing: float) -> Border:
        """The branch with another spacing of points, a fraction of the range. No matrices are computed.

        Raises:
            OutsideDomain: the spacing is not above 0.
        """
        _check_spacing(spacing)
        return Border.along(self.curve, self.lattice, self.closed, spacing)

    @property
    def off(self) -> float:
        """Largest distance of the curve from the border, as a fraction of the range; see BorderCurve."""
        return self.curve.off

    @property
    def kind(self) -> list[str]:
        """Loss of stability at each point: DIVERGENCE, FLUTTER or DOUBLING."""
        real = np.abs(self.multiplier.imag) <= _REAL
        return np.where(real, np.where(self.multiplier.real > 0, DIVERGENCE, DOUBLING), FLUTTER).tolist()


@dataclass(frozen=True)
class Borders(Tabular):
    """All branches in a range.

    Attributes:
        branches: branches, the longest first.
        stable_share: stable fraction of the range's area in which the balanced state exists. On a logarithmic axis
            the logarithm counts.
        complete_to: sides of the first grid's cells as fractions of the range. Every island and every band that
            contains a point of that grid is found, so everything as large as a cell in both directions. Smaller parts
            are found if the multipliers at the grid points indicate them.
        computed: number of computed points of the grid.
        bare: parts of the range in the plane's coordinates (u from, to; v from, to) in which the balanced state does
            not exist or its matrix is not smooth. Borders are not searched there.
    """

    branches: tuple[Border, ...]
    stable_share: float
    complete_to: tuple[float, float]
    computed: int
    bare: tuple[tuple[Span, Span], ...]

    @property
    def heading(self) -> str:
        """Number of branches and the stable fraction."""
        return f"Borders: {number_of(len(self.branches), 'branch', 'branches')}, {100 * self.stable_share:.3g} % stable"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each point of each branch."""
        every = list(enumerate(self.branches))
        return {
            "branch": [number for number, b in every for _ in b.x],
            "x": [x for _, b in every for x in b.x],
            "y": [y for _, b in every for y in b.y],
            "kind": [kind for _, b in every for kind in b.kind],
        }


def stability_borders(
    plane: Plane,
    x_range: Span,
    y_range: Span,
    *,
    first: tuple[int, int] = _FIRST,
    levels: int = LEVELS,
    spacing: float = _SPACING,
    logarithmic: tuple[bool, bool] = (False, False),
    progress: Callable[[float], None] | None = None,
) -> Borders:
    """Find every border of stability of Type I in a range of a plane.

    Args:
        x_range, y_range: lower and upper limit, in values of the plane's parameters.
        first: numbers of cells of the first grid along x and y. All its points are computed.
        levels: number of halvings, in both directions, of a cell that may contain a border; 0 … 7.
        spacing: largest distance of the points of a branch, as a fraction of the range. On a map with 1/spacing points
            per side, straight lines between the points deviate by at most half a pitch along a line of the map.
        logarithmic: whether x and y are divided evenly in their logarithm.
        progress: called with the completed share, 0 … 1.
    Raises:
        OutsideDomain: an empty range, a logarithmic range not above 0, a first grid without cells, a number of levels
            outside 0 … 7, or a spacing not above 0.
    """
    if not (x_range[0] < x_range[1] and y_range[0] < y_range[1] and np.all(np.isfinite([*x_range, *y_range]))):
        raise OutsideDomain(f"ranges must rise and be finite, got x {x_range} and y {y_range}")
    if any(low <= 0 for (low, _), log in zip((x_range, y_range), logarithmic, strict=True) if log):
        raise OutsideDomain(f"logarithmic ranges must lie above 0, got x {x_range} and y {y_range}")
    if not 0 <= levels <= 7:
        raise OutsideDomain(f"levels must lie in 0 … 7, got {levels!r}")
    if not min(first) >= 1:
        raise OutsideDomain(f"the first grid needs at least one cell each way, got {first!r}")
    _check_spacing(spacing)
    notify = progress or _ignore
    lattice = Lattice(x_range, y_range, first[0] << levels, first[1] << levels, logarithmic)
    with ThreadPool(max_workers=cores()) as pool:
        patches = cover(pool, plane, x_range, y_range)
        notify(0.2)

        def excess(x: Array, y: Array) -> Array:
            return np.abs(patches.eigenvalues(pool, x, y)[:, 0]) ** 2 - 1.0

        known = KnownPoints(lattice, excess)
        cells = border_cells(known, *first, levels, lambda share: notify(0.2 + 0.3 * share))
        crossings = crossings_of(lattice, cells, excess)
        slopes = _slopes(pool, patches, lattice)
        curves = _followed(patches, lattice, crossings, slopes, lambda share: notify(0.6 + 0.4 * share))
    branches = [Border.along(curve, lattice, closed, spacing) for curve, closed in curves]
    return Borders(
        tuple(sorted(branches, key=lambda branch: -len(branch.x))),
        cells.clear_stable + float(crossings.stable_share.sum()) / (lattice.columns * lattice.rows),
        (1 / first[0], 1 / first[1]),
        len(known),
        patches.bare,
    )


def _ignore(share: float) -> None:
    del share


def _check_spacing(spacing: float) -> None:
    if not 0 < spacing < np.inf:
        raise OutsideDomain(f"the spacing of a border's points must be above 0 and finite, got {spacing!r}")


def _slopes(pool: ThreadPoolExecutor, patches: MatrixPatches, lattice: Lattice) -> Slopes:
    """The largest eigenvalue and its derivatives in the unit square."""
    along_x = _rate(lambda share: patches.plane.x.of(lattice.x(share * lattice.columns)))
    along_y = _rate(lambda share: patches.plane.y.of(lattice.y(share * lattice.rows)))

    def slopes(at: Complex) -> tuple[Complex, Complex, Complex]:
        found = patches.with_slopes(pool, *lattice.places(at))
        return found[:, 0], found[:, 1] * along_x(at.real), found[:, 2] * along_y(at.imag)

    return slopes


def _rate(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Derivative on 0 … 1 of a smooth function that is not defined outside."""

    def rate(at: Array) -> Array:
        first = np.clip(at - _STEP, 0.0, 1.0 - 2 * _STEP)
        low, middle, high = (function(first + k * _STEP) for k in range(3))
        return ((high - low) + 2 * ((at - first) / _STEP - 1) * (high - 2 * middle + low)) / (2 * _STEP)

    return rate


def _followed(
    patches: MatrixPatches, lattice: Lattice, crossings: Crossings, slopes: Slopes, progress: Callable[[float], None]
) -> list[tuple[BorderCurve, bool]]:
    """Follow borders until every crossing of the grid lies on one. Returns curves and whether they are closed."""

    def excess(at: complex) -> float:
        return abs(patches.largest_there(*lattice.place(at))) ** 2 - 1.0

    seeds = crossings.columns / lattice.columns + 1j * crossings.rows / lattice.rows
    tangents = curve_tangents(seeds, slopes)
    waiting = np.ones(len(seeds), bool)
    curves: list[tuple[BorderCurve, bool]] = []
    while np.any(waiting):
        seed = complex(seeds[np.argmax(waiting)])
        waiting[np.argmax(waiting)] = False
        followed = follow(excess, seed)
        if len(followed.points) < 2:
            continue
        curve = curve_through(np.array(followed.points), slopes)
        curves.append((curve, followed.closed))
        waiting[waiting] = ~curve.holds(seeds[waiting], tangents[waiting])
        progress(float(1 - waiting.mean()))
    return curves


def _upper(multipliers: Complex) -> Complex:
    """The multipliers, of each pair the one with Im μ ≥ 0."""
    return np.where(np.imag(multipliers) < 0, np.conj(multipliers), multipliers)
