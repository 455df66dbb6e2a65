"""Coexisting stable motions over two numbers of a rig: balance, other steady states, slipping orbits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.maps.question import MapQuestion
from analysis.maps.states import StateArrays
from dynamics.stability.map_plane import Plane
from dynamics.steady.basins.coexisting import StableMotions, stable_motions
from rig_basics.arrays import Array

MOTIONS = ("I", "II", "III", "one", "slipping")
"""Kinds of motion; the n-th is the bit 2ⁿ of `stable`."""
COEXISTENCE_ARRAYS: tuple[str, ...] = (
    "stable",
    "multiplier_I",
    "multiplier_II",
    "multiplier_III",
    "multiplier_one",
    "multiplier_slipping",
    "slipping_orbits",
    "turns3_per_rev",
    "turns4_per_rev",
)


@dataclass(frozen=True)
class CoexistenceMap:
    """Stable motions at every point of a grid.

    Attributes:
        question: question that was answered.
        x, y: values of its numbers, shapes (n,) and (m,).
        arrays: arrays by the names of COEXISTENCE_ARRAYS, shape (m, n); see `motions_at`.
    """

    question: MapQuestion
    x: Array
    y: Array
    arrays: StateArrays

    @property
    def shares(self) -> dict[str, float]:
        """Coexisting motions, as "I + slipping", to their share of the points, the largest first."""
        counts = Counter(words_of(value) for value in self.arrays["stable"].ravel().tolist())
        return {name: count / self.arrays["stable"].size for name, count in counts.most_common()}


def words_of(stable: float) -> str:
    """Return the names of the motions in a value of `stable`."""
    if np.isnan(stable):
        return "no answer"
    bits = int(stable)
    return " + ".join(name for i, name in enumerate(MOTIONS) if bits & (1 << i)) or "nothing stable found"


def motions_at(
    plane: Plane,
    x: Array,
    y: Array,
    columns: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Array]:
    """Find the stable motions at the points of a grid. Slipping orbits are continued to every neighbour.

    Args:
        plane: rigs over the axes.
        x, y: coordinates of the points, row by row, shape (points,).
        columns: points in a row; None treats all points as one row.
        workers: number of threads; None for one per core.
        progress: called with the completed share, 0 … 1.
    Returns:
        Arrays of shape (points,): `stable`, the sum of 2ⁿ over the existing stable motions of MOTIONS, NaN if the
        search failed; the largest multiplier over one revolution of the most stable motion of each kind, across the
        orbit for a slipping one; the number of slipping orbits, and turns of A and B against the rotor per revolution
        on the most stable of them. NaN where no such motion exists.
    """
    points = [plane.rig_at(a, b) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    found = stable_motions(
        [rig for rig, _ in points],
        [speed for _, speed in points],
        columns=columns,
        workers=workers,
        progress=progress,
    )
    rows = [_numbers(one) for one in found]
    return {name: np.array([row[name] for row in rows]) for name in COEXISTENCE_ARRAYS}


def _numbers(found: StableMotions) -> dict[str, float]:
    numbers: dict[str, float] = dict.fromkeys(COEXISTENCE_ARRAYS, np.nan)
    if found.refused:
        return numbers
    numbers["stable"] = float(sum(1 << MOTIONS.index(name) for name in found.names))
    numbers["slipping_orbits"] = float(len(found.slipping))
    for state in found.steady:
        name = f"multiplier_{state.type}"
        numbers[name] = float(np.nanmin([numbers[name], state.multiplier_max]))
    if found.slipping:
        best = min(found.slipping, key=lambda orbit: orbit.multiplier_across)
        numbers["multiplier_slipping"] = best.multiplier_across
        numbers["turns3_per_rev"], numbers["turns4_per_rev"] = best.turns_per_revolution
    return numbers
