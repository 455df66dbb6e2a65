# pyright: strict
"""Borders of stability as curves: where the largest multiplier of the balanced state has the modulus 1.

A grid whose cells are halved wherever a border might be finds where borders cross the sides of its finest cells
(`border_cells`, `border_crossings`); each border is followed from such a crossing with steps of its own
(`border_following`), until every crossing lies on one: so each is found, and none is cut off by the grid.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import OutsideDomain
from dynamics.stability.border_cells import KnownPoints, Lattice, border_cells
from dynamics.stability.border_crossings import Crossings, crossings_of
from dynamics.stability.border_following import SHORTEST, follow
from dynamics.stability.map_plane import Plane
from dynamics.stability.map_points import cores
from dynamics.stability.matrix_patches import MatrixPatches, cover

_FIRST = (96, 72)  # cells of the first grid
_LEVELS = 2
_OFF, _SLACK = 0.02, 2 * SHORTEST  # how far off a chord its curve may be: of the chord, which turns by 3°, and besides
_REAL = 1e-9  # |Im μ| below which a multiplier counts as real

Array = NDArray[np.floating]
Span = tuple[float, float]
DIVERGENCE, FLUTTER, DOUBLING = "divergence", "flutter", "period doubling"
"""A multiplier leaves the unit circle at +1; a pair beside the real axis; one at −1."""


@dataclass(frozen=True)
class Border:
    """One branch.

    Attributes:
        x, y: its points in order, shape (n,); what is stable lies on the left hand. The first is repeated at the end
            where it is closed.
        multiplier: that crosses the unit circle, of a pair the one with Im μ ≥ 0, complex, shape (n,).
        closed: whether it is an island; otherwise both ends lie on the range's sides, or where balance ends.
    """

    x: Array
    y: Array
    multiplier: NDArray[np.complexfloating]
    closed: bool

    @property
    def kind(self) -> list[str]:
        """How stability is lost at each point: DIVERGENCE, FLUTTER or DOUBLING."""
        real = np.abs(self.multiplier.imag) <= _REAL
        return np.where(real, np.where(self.multiplier.real > 0, DIVERGENCE, DOUBLING), FLUTTER).tolist()


@dataclass(frozen=True)
class Borders:
    """All branches in a range.

    Attributes:
        branches: the longest first.
        stable_share: of the range's area where the balanced state exists and is stable; of a logarithmic axis its
            logarithm counts.
        complete_to: sides of the finest cells as shares of the range: what is smaller may have been missed.
        computed: points of the grid that were computed.
        bare: parts of the range in the plane's coordinates (u from, to; v from, to) in which no balanced state exists,
            or its matrix is not smooth: no border is looked for there.
    """

    branches: tuple[Border, ...]
    stable_share: float
    complete_to: tuple[float, float]
    computed: int
    bare: tuple[tuple[Span, Span], ...]


def stability_borders(
    plane: Plane,
    x_range: Span,
    y_range: Span,
    *,
    levels: int = _LEVELS,
    logarithmic: tuple[bool, bool] = (False, False),
    progress: Callable[[float], None] | None = None,
) -> Borders:
    """Every border of stability of Type I in a range of a plane.

    Args:
        x_range, y_range: from, to, in values of the plane's numbers.
        levels: how often a cell of the first grid (96 × 72) is halved both ways; 0 … 7.
        logarithmic: whether x, and whether y, is divided evenly in its logarithm.
        progress: called with the share done, 0 … 1.
    Raises:
        OutsideDomain: an empty range, a logarithm of what is not above 0, or a number of levels outside.
    """
    if not (x_range[0] < x_range[1] and y_range[0] < y_range[1] and np.all(np.isfinite([*x_range, *y_range]))):
        raise OutsideDomain(f"ranges must rise and be finite, got x {x_range} and y {y_range}")
    if any(low <= 0 for (low, _), log in zip((x_range, y_range), logarithmic, strict=True) if log):
        raise OutsideDomain(f"logarithmic ranges must lie above 0, got x {x_range} and y {y_range}")
    if not 0 <= levels <= 7:
        raise OutsideDomain(f"levels must lie in 0 … 7, got {levels!r}")
    tell = progress or _unheard
    lattice = Lattice(x_range, y_range, _FIRST[0] << levels, _FIRST[1] << levels, logarithmic)
    with ThreadPoolExecutor(max_workers=cores()) as pool:
        patches = cover(pool, plane, x_range, y_range)
        tell(0.2)

        def excess(x: Array, y: Array) -> Array:
            return np.abs(patches.eigenvalues(pool, x, y)[:, 0]) ** 2 - 1.0

        known = KnownPoints(lattice, excess)
        cells = border_cells(known, *_FIRST, levels, lambda share: tell(0.2 + 0.3 * share))
        crossings = crossings_of(lattice, cells, excess)
        branches = _followed(patches, lattice, crossings, lambda share: tell(0.6 + 0.4 * share))
    return Borders(
        tuple(sorted(branches, key=lambda branch: -len(branch.x))),
        cells.clear_stable + float(crossings.stable_share.sum()) / (lattice.columns * lattice.rows),
        (1 / lattice.columns, 1 / lattice.rows),
        len(known),
        patches.bare,
    )


def _unheard(share: float) -> None:
    del share


def _followed(
    patches: MatrixPatches, lattice: Lattice, crossings: Crossings, tell: Callable[[float], None]
) -> list[Border]:
    """Follow borders until every crossing of the grid lies on one."""

    def excess(at: complex) -> float:
        return abs(patches.largest_there(*lattice.place(at))) ** 2 - 1.0

    seeds = crossings.columns / lattice.columns + 1j * crossings.rows / lattice.rows
    waiting = np.ones(len(seeds), bool)
    branches: list[Border] = []
    while np.any(waiting):
        seed = complex(seeds[np.argmax(waiting)])
        waiting[np.argmax(waiting)] = False
        followed = follow(excess, seed)
        waiting[waiting] = ~_lie_on(seeds[waiting], np.array(followed.points))
        places = np.array([lattice.place(at) for at in followed.points])
        roots = [patches.largest_there(x, y) for x, y in places.tolist()]
        branches.append(Border(places[:, 0], places[:, 1], _upper(np.array(roots) ** 2), followed.closed))
        tell(float(1 - waiting.mean()))
    return branches


def _lie_on(points: NDArray[np.complexfloating], line: NDArray[np.complexfloating]) -> NDArray[np.bool_]:
    """Which points lie on a line, as far as its chords tell."""
    near = np.zeros(len(points), bool)
    for first, second in itertools.pairwise(line.tolist()):
        along = (second - first) / abs(second - first)
        off = (points - first) * np.conj(along)
        reach = abs(second - first)
        near |= (np.abs(off.imag) <= _OFF * reach + _SLACK) & (off.real >= -_SLACK) & (off.real <= reach + _SLACK)
    return near


def _upper(multipliers: NDArray[np.complexfloating]) -> NDArray[np.complexfloating]:
    """Of each pair the one above the real axis."""
    return np.where(np.imag(multipliers) < 0, np.conj(multipliers), multipliers)
