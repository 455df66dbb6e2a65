"""Lines held against the signs of a map: what a grid of points can show of a border, and what it can't.

Between two neighbouring points of a map of different sign an odd number of borders crosses, between two of the same
sign an even number. So along each line of the grid every stretch between two points is right or wrong. Where a border
is drawn in the wrong stretch, that one and the right one are both wrong: how far the crossing is from the right one, in
pitches, is how far the line is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Place = tuple[float, float]


@dataclass
class Agreement:
    """What a comparison found.

    Attributes:
        changes: of sign between neighbouring points of the map.
        crossings: of the lines with the grid's lines.
        pairs: crossings that the map can't show, two in one stretch.
        misplaced: changes of sign whose crossing lies in another stretch.
        worst_pitches: how far it is from the right one at most; infinite where none is left for a change.
        worst_place: where, (along the line, across).
        unseen: crossings that the map denies and that no change of sign wants.
    """

    changes: int = 0
    crossings: int = 0
    pairs: int = 0
    misplaced: int = 0
    worst_pitches: float = 0.0
    worst_place: Place | None = None
    unseen: list[Place] = field(default_factory=list[Place])

    def __str__(self) -> str:
        where = f" at {self.worst_place[0]:.5g}, {self.worst_place[1]:.5g}" if self.worst_place else ""
        return (
            f"{self.changes} changes of sign, {self.crossings} crossings, {self.pairs} pairs within a pitch; "
            f"{self.misplaced} changes with the crossing in another stretch, "
            f"by {self.worst_pitches:.3f} pitches at most{where}; "
            f"{len(self.unseen)} crossings that the map denies"
        )


def compare(stable: NDArray[np.bool_], along: Array, across: Array, lines: Sequence[tuple[Array, Array]]) -> Agreement:
    """Hold lines against a map, along one of its directions.

    Args:
        stable: signs at points, shape (len(across), len(along)).
        along, across: evenly spaced values of the grid; each row of points is a line of it.
        lines: places along and across of each line's points.
    """
    crossed = [_crossings(*line, across) for line in lines]
    rows = np.concatenate([rows for rows, _ in crossed]) if crossed else np.empty(0, np.intp)
    places = np.concatenate([places for _, places in crossed]) if crossed else np.empty(0)
    pitch = along[1] - along[0]
    stretch = np.floor((places - along[0]) / pitch).astype(np.intp)
    inside = (stretch >= 0) & (stretch < len(along) - 1)
    rows, places, stretch = rows[inside], places[inside], stretch[inside]
    count = np.zeros((len(across), len(along) - 1), np.intp)
    np.add.at(count, (rows, stretch), 1)
    changed = stable[:, 1:] != stable[:, :-1]
    found = Agreement(int(changed.sum()), len(places), int(np.sum(count // 2)))
    wrong = changed != (count % 2 == 1)
    for row in np.flatnonzero(wrong.any(axis=1)):
        wanted = np.flatnonzero(wrong[row] & changed[row])
        there = (rows == row) & np.isin(stretch, np.flatnonzero(wrong[row] & ~changed[row]))
        _match(found, along, float(across[row]), wanted, np.sort(places[there]))
    return found


def _crossings(along: Array, across: Array, grid: Array) -> tuple[NDArray[np.intp], Array]:
    """Rows of a grid that a line crosses, and where along them."""
    at = (across - grid[0]) / (grid[1] - grid[0])
    below = np.floor(at).astype(np.intp)
    steps = np.abs(np.diff(below))
    piece = np.repeat(np.arange(len(steps)), steps)
    turn = np.arange(len(piece)) - np.repeat(np.cumsum(steps) - steps, steps)
    row = np.minimum(below[piece], below[piece + 1]) + 1 + turn
    inside = (row >= 0) & (row < len(grid))
    piece, row = piece[inside], row[inside]
    share = (row - at[piece]) / (at[piece + 1] - at[piece])
    return row, along[piece] + share * (along[piece + 1] - along[piece])


def _match(found: Agreement, along: Array, across: float, wanted: NDArray[np.intp], places: Array) -> None:
    """Give each change of sign the nearest crossing that is left, nearest pairs first."""
    pitch, free = along[1] - along[0], np.ones(len(places), bool)
    off = np.maximum(along[wanted, None] - places, places - along[wanted + 1, None]) / pitch
    found.misplaced += len(wanted)
    for _ in wanted:
        far = float(np.min(off, initial=np.inf))
        which = np.unravel_index(np.argmin(off), off.shape) if off.size else None
        if not far < found.worst_pitches:
            place = along[wanted[0]] if which is None else along[wanted[which[0]]]
            found.worst_pitches, found.worst_place = far, (float(place), across)
        if which is not None:
            off[which[0]], off[:, which[1]], free[which[1]] = np.inf, np.inf, False
    found.unseen += [(float(place), across) for place in places[free]]
