"""End states of releases over two numbers of a rig: state reached from the real locks, and the approach to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.maps.question import MapQuestion
from analysis.maps.refinement import refined_grid
from dynamics.stability.map_plane import Plane
from dynamics.steady.basins.single import release_ends
from dynamics.steady.outcome import PLAY_RAD
from rig_basics.arrays import Array, Indices

StateArrays = Mapping[str, NDArray[np.floating]]
"""Arrays by name, see `states_at`."""

STATES = ("refused", "not settled", "I", "II", "III", "one", "slipping")
"""States in the order of their numbers in arrays and files."""
RELEASED_RAD = (PLAY_RAD, np.pi - 0.5 * PLAY_RAD)
"""Angles of A and B at the locks: 0° and 180°, with some play, because an exact unstable equilibrium never ends."""
ARRAYS = (
    "state",
    "sure",
    "theta3_deg",
    "theta4_deg",
    "turns3_per_rev",
    "turns4_per_rev",
    "multiplier_max",
    "settled_s",
    "amplitude_m",
)


@dataclass(frozen=True)
class StateMap:
    """End state of a release at every point of a grid.

    Attributes:
        question: question that was answered.
        x, y: values of its numbers, shapes (n,) and (m,).
        arrays: arrays by the names of ARRAYS, shape (m, n); see `states_at`.
        computed: computed points of a refined map; the others have the state of their neighbours and no further
            values. None if all were computed.
    """

    question: MapQuestion
    x: Array
    y: Array
    arrays: StateArrays
    computed: NDArray[np.bool_] | None = None

    @property
    def state(self) -> NDArray[np.intp]:
        """Indices into STATES, shape (m, n)."""
        return self.arrays["state"].astype(np.intp)

    @property
    def shares(self) -> dict[str, float]:
        """Share of the points of each state that occurs."""
        counts = np.bincount(self.state.ravel(), minlength=len(STATES))
        return {name: float(count) / self.state.size for name, count in zip(STATES, counts, strict=True) if count}

    @property
    def unsure_share(self) -> float:
        """Share of the computed points whose end state changes within the stated error."""
        sure = self.arrays["sure"]
        return float(np.count_nonzero(sure == 0)) / max(1, int(np.count_nonzero(np.isfinite(sure))))


def states_at(
    plane: Plane,
    x: Array,
    y: Array,
    seconds: float,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Array]:
    """Compute the end state of a release at each of many points.

    Args:
        plane: rigs over the axes.
        x, y: coordinates of the points, shape (points,).
        seconds: duration of a release, s.
        workers: number of threads; None for one per core.
        progress: called with the completed share, 0 … 1.
    Returns:
        Arrays of shape (points,): `state`, an index into STATES; `sure`, 0 at a boundary and NaN where refused; mean
        angles in degrees of a state at rest; turns of A and B against the rotor per revolution; largest multiplier of
        the state reached; time until the motion stays near it, s; rms distance of the disk's centre from the middle of
        its orbit at the end, m. NaN where a value does not exist.
    """
    points = [plane.rig_at(a, b) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    rigs, speeds = [rig for rig, _ in points], [speed for _, speed in points]
    found = release_ends(rigs, speeds, RELEASED_RAD, seconds, workers=workers, progress=progress)
    return {
        "state": np.array([STATES.index(name) for name in found.name.tolist()], np.float64),
        "sure": np.where(found.name == "refused", np.nan, found.sure),
        "theta3_deg": np.degrees(found.theta_rad[:, 0]),
        "theta4_deg": np.degrees(found.theta_rad[:, 1]),
        "turns3_per_rev": found.turns_per_revolution[:, 0],
        "turns4_per_rev": found.turns_per_revolution[:, 1],
        "multiplier_max": found.multiplier,
        "settled_s": found.settled_s,
        "amplitude_m": found.amplitude_m,
    }


def refined_states(
    question: MapQuestion,
    states: Callable[[Indices, Indices], Mapping[str, Array]] | None = None,
    progress: Callable[[float], None] | None = None,
) -> StateMap:
    """Compute the states on the question's finest grid where they change.

    Args:
        question: question with the grid.
        states: computes points of that grid by their columns and rows, see `states_at`; None: in this process.
        progress: called with the completed share, as far as it can be estimated.
    """
    x, y = (axis.values for axis in question.fine)
    arrays = {name: np.full((len(y), len(x)), np.nan) for name in ARRAYS}
    plane = question.plane()

    def here(columns: Indices, rows: Indices) -> Mapping[str, Array]:
        return states_at(plane, x[columns], y[rows], question.seconds)

    def evaluate(at_x: Array, at_y: Array) -> Array:
        rows, columns = np.searchsorted(y, at_y), np.searchsorted(x, at_x)
        found = (states or here)(columns, rows)
        for name, values in found.items():
            arrays[name][rows, columns] = values
        return found["state"]

    found = refined_grid(evaluate, x, y, question.refine, _classes, interpolated=False, progress=progress)
    return StateMap(question, x, y, {**arrays, "state": found.values}, found.computed)


def _classes(states: Array) -> NDArray[np.intp]:
    return states.astype(np.intp)
