# pyright: strict
"""Points of a map, each by explicit steps beside seven others, or one by one by whatever method serves it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import NotConverged
from dynamics.stability.floquet import floquet_multipliers
from dynamics.stability.floquet.lanes import LANES, half_turn_matrices, largest_multipliers, node_table

LADDER = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)  # steps per half revolution
_BATCH = 128 * LANES  # points a thread takes at a time
_NODES = 16 * LANES  # the same where only matrices are wanted


class MapPoints:
    """Points of a map: all share the pendulums, the balanced angles and the total mass.

    Args:
        parameters: the rig; k2 is replaced by K k1.
        angles: θ3, θ4 of the balanced state, rad.
        speed_ratios, stiffness_ratios: Ω and K of each point, shape (points,).

    Attributes:
        rigs: κ1, κ2, γ1, γ2 (kg), δ3, δ4 of each point, shape (points, 6); see `lanes`.
        length_m: unit of displacement, sqrt(J/M_S).
    """

    def __init__(
        self,
        parameters: RotorParameters,
        angles: tuple[float, float],
        speed_ratios: NDArray[np.floating],
        stiffness_ratios: NDArray[np.floating],
    ) -> None:
        p = self.parameters = parameters
        self.angles = angles
        self.speed_ratios, self.stiffness_ratios = speed_ratios, stiffness_ratios
        speed = speed_ratios * p.natural_frequencies_rad_s[0]
        k2 = stiffness_ratios * p.k1_N_per_m
        c1, c2 = p.damping_Ns_per_m[0], 2 * p.zeta2 * np.sqrt(k2 * p.total_mass_kg)
        packed = p.packed()
        self.rigs = np.column_stack(
            [
                p.k1_N_per_m / speed**2,
                k2 / speed**2,
                c1 / speed,
                c2 / speed,
                packed[10] / packed[8] / speed,
                packed[11] / packed[9] / speed,
            ]
        )
        self.length_m = math.sqrt((packed[8] + packed[9]) / 2 / p.total_mass_kg)

    def __len__(self) -> int:
        return len(self.speed_ratios)

    @property
    def units(self) -> NDArray[np.floating]:
        """Units of the eight states in which every point's matrix is of moderate size, shape (8,)."""
        fast = np.sqrt(np.max(self.rigs[:, :2], axis=0) / self.parameters.total_mass_kg)
        rates = self.length_m * np.maximum(1.0, fast)
        return np.array([self.length_m, self.length_m, 1.0, 1.0, *rates, 1.0, 1.0])

    def first_rung(self, accuracy: float) -> NDArray[np.intp]:
        """Index into the ladder of steps to begin with; beyond its end: not a case for explicit steps.

        Fitted: the finer of n/2 and n steps meets the accuracy when its step is 1.0 radian of the fastest
        undamped rate at an accuracy of 1e-8 and a span of 20 radians, and falls with the ninth root of both.
        """
        if not (self.parameters.a.present and self.parameters.b.present):
            return np.full(len(self), len(LADDER))
        mass = self.parameters.total_mass_kg
        fast = np.sqrt(self.rigs[:, :2] / mass)
        damped = np.maximum(self.parameters.zeta1, self.parameters.zeta2)
        swing = np.pi * np.maximum(np.max(fast, axis=1), 1.0)
        stiff = np.pi * np.maximum(np.max(self.rigs[:, 4:], axis=1), 2 * damped * np.max(fast, axis=1))
        length = 1.0 * (accuracy / 1e-8 * 20.0 / swing) ** (1 / 9)
        steps = np.maximum(swing / length, stiff / 2.5)
        return np.asarray(np.searchsorted(np.array(LADDER), steps), np.intp)

    def multipliers(
        self,
        pool: ThreadPoolExecutor,
        wanted: NDArray[np.intp],
        accuracy: float,
        done: Callable[[NDArray[np.intp], NDArray[np.floating], NDArray[np.floating]], None],
    ) -> NDArray[np.intp]:
        """Largest multipliers of points by explicit steps, more of them where the bound misses the accuracy.

        Args:
            wanted: the points' numbers.
            accuracy: relative to max(1, largest modulus).
            done: called with points that meet it, their multipliers and bounds, from the calling thread.
        Returns:
            The points that explicit steps do not serve.
        """
        rung = np.full(len(self), -1)
        rung[wanted] = self.first_rung(accuracy)[wanted]
        for i, steps in enumerate(LADDER):
            here = np.flatnonzero(rung == i)
            for batch, found, errors in self._explicit(pool, here, steps):
                met = errors <= accuracy * np.maximum(1.0, found)
                rung[batch] = -1
                rung[batch[~met]] = _next_rung(i, found[~met], errors[~met], accuracy)
                done(batch[met], found[met], errors[met])
        return np.flatnonzero(rung >= 0)

    def _explicit(
        self, pool: ThreadPoolExecutor, points: NDArray[np.intp], steps: int
    ) -> Iterable[tuple[NDArray[np.intp], NDArray[np.floating], NDArray[np.floating]]]:
        """Run points with one number of steps on all cores; yields each batch when it is done."""
        if len(points) == 0:
            return
        fine, coarse = (node_table(self.parameters, *self.angles, n) for n in (steps, steps // 2))
        size = max(LANES, min(_BATCH, -(-len(points) // (2 * LANES)) * LANES))
        pending: dict[Future[None], tuple[NDArray[np.intp], NDArray[np.floating], NDArray[np.floating]]] = {}
        for start in range(0, len(points), size):
            batch = points[start : start + size]
            found, errors = np.empty(len(batch)), np.empty(len(batch))
            arguments = (fine, coarse, self.rigs[batch], self.length_m, self.parameters.total_mass_kg, found, errors)
            pending[pool.submit(largest_multipliers, *arguments)] = (batch, found, errors)
        for future in as_completed(pending):
            future.result()
            yield pending[future]

    def half_turns(self, pool: ThreadPoolExecutor, units: NDArray[np.floating], steps: int) -> NDArray[np.floating]:
        """D Φ(π) of every point, shape (points, 8, 8).

        All points take the same number of steps, so that what the steps leave is a polynomial in the rigs' numbers
        and as smooth as the matrix itself.

        Args:
            units: of the eight states, shape (8,).
            steps: per half revolution.
        """
        matrices, table = np.empty((len(self), 8, 8)), node_table(self.parameters, *self.angles, steps)
        pending: list[Future[None]] = []
        for start in range(0, len(self), _NODES):
            part = slice(start, start + _NODES)
            pending.append(pool.submit(half_turn_matrices, table, self.rigs[part], units, matrices[part]))
        for future in pending:
            future.result()
        return matrices

    def one(self, point: int, accuracy: float) -> tuple[float, float]:
        """Largest multiplier of a point by whatever method serves it, with its bound.

        Raises:
            NotConverged: none does, even roughly.
        """
        p = self.parameters
        rig = dataclasses.replace(p, k2_N_per_m=float(self.stiffness_ratios[point]) * p.k1_N_per_m)
        speed = float(self.speed_ratios[point]) * p.natural_frequencies_rad_s[0]
        matrix = type_one(rig, *self.angles, speed)
        last: NotConverged | None = None
        for looser in (1.0, 1e2, 1e4, 1e6):
            try:
                answer = floquet_multipliers(matrix, min(looser * accuracy, 0.1))
            except NotConverged as refusal:
                last = refusal
            else:
                return answer.largest, answer.error_estimate
        where = f"Ω = {self.speed_ratios[point]:.6g}, K = {self.stiffness_ratios[point]:.6g}"
        raise NotConverged(f"stability map at {where}: {last}; leave this point out") from last


def _next_rung(i: int, found: NDArray[np.floating], errors: NDArray[np.floating], accuracy: float) -> NDArray[np.intp]:
    """Where points go that missed the accuracy with LADDER[i] steps: the error falls with the eighth power."""
    factor = np.nan_to_num((errors / (accuracy * np.maximum(1.0, found))) ** (1 / 8), nan=2.0, posinf=2.0)
    return np.maximum(i + 1, np.searchsorted(np.array(LADDER), LADDER[i] * np.minimum(1.1 * factor, 4.0)))
