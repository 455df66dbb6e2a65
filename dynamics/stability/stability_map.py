"""Largest multiplier of the balanced state over a plane of speed ratio and stiffness ratio."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arguments import need_number, numbers
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters, physics_of
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.stability.floquet import floquet_multipliers
from dynamics.stability.floquet.lanes import LANES, largest_multipliers, node_table

_LADDER = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)  # steps per half revolution
_BATCH = 128 * LANES  # points a thread takes at a time
_MOST_POINTS = 20_000_000
_LEAST_RATIO, _GREATEST_RATIO = 1e-15, 1e15  # beyond, squares and quotients leave the range of a double
_FINEST = 1e-12


@dataclass(frozen=True)
class StabilityMap:
    """The largest multiplier of Type I over a grid.

    Attributes:
        speed_ratio: Ω = ω/ω_n1, shape (n,).
        stiffness_ratio: K = k2/k1, shape (m,).
        multiplier_max: largest modulus over one revolution, shape (m, n).
        error_estimate: bound on its error, shape (m, n); more than was asked for where no method gives that
            (see `missed`).
        accuracy: what was asked for.
        method: how many points which method served.
    """

    speed_ratio: NDArray[np.floating]
    stiffness_ratio: NDArray[np.floating]
    multiplier_max: NDArray[np.floating]
    error_estimate: NDArray[np.floating]
    method: str
    accuracy: float

    @property
    def missed(self) -> int:
        """Points whose bound is larger than what was asked for."""
        return int(np.count_nonzero(self.error_estimate > self.accuracy * np.maximum(1.0, self.multiplier_max)))

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether the largest multiplier lies inside the unit circle by more than its error, shape (m, n)."""
        return self.multiplier_max + self.error_estimate < 1.0


def stability_map(
    rig: RotorParameters | object,
    speed_ratios: NDArray[np.floating],
    stiffness_ratios: NDArray[np.floating],
    accuracy: float = 1e-8,
    progress: Callable[[float], None] | None = None,
) -> StabilityMap:
    """Largest modulus of the Type I multipliers over one revolution on a grid.

    Args:
        rig: RotorParameters, or anything whose `.physics` is; k1 and the damping ratios stay, k2 = K k1. Dry friction
            is left out.
        speed_ratios: Ω = ω/ω_n1, shape (n,), 1e-15 … 1e15.
        stiffness_ratios: K = k2/k1, shape (m,), 1e-15 … 1e15.
        accuracy: bound on the error, relative to max(1, largest modulus); 1e-12 … 0.1.
        progress: called with the share of points done, 0 … 1, from the calling thread.
    Raises:
        OutsideDomain: a ratio or an accuracy outside the range.
        NoBalancedState: no balanced state exists for these first mass moments.
        NotConverged: a point whose multiplier can't be had even roughly; the message names it.
    """
    speeds, stiffness = (
        np.atleast_1d(numbers("speed_ratios", speed_ratios)),
        np.atleast_1d(numbers("stiffness_ratios", stiffness_ratios)),
    )
    for name, values in (("speed_ratios", speeds), ("stiffness_ratios", stiffness)):
        if values.ndim != 1 or not np.all(np.isfinite(values) & (values > 0)):
            raise OutsideDomain(f"{name} must be one-dimensional, finite and above 0, got {values!r}")
        if np.any((values < _LEAST_RATIO) | (values > _GREATEST_RATIO)):
            raise OutsideDomain(
                f"{name} must be above 0 and lie in {_LEAST_RATIO:g} … {_GREATEST_RATIO:g}, got "
                f"{values.min():g} … {values.max():g}"
            )
    need_number(accuracy=accuracy)
    if not _FINEST <= accuracy <= 0.1:
        raise OutsideDomain(f"accuracy must lie in {_FINEST:g} … 0.1, got {accuracy!r}")
    if len(speeds) * len(stiffness) > _MOST_POINTS:
        raise OutsideDomain(f"a map holds at most {_MOST_POINTS:.0e} points, asked {len(speeds)} × {len(stiffness)}")
    parameters = physics_of(rig)
    angles = balanced_angles(parameters)
    if not angles:
        raise NoBalancedState("no balanced state to map: it needs |S_A − S_B| ≤ S_P ≤ S_A + S_B")
    type_one(parameters, *angles[0], parameters.speed_rad_s(1.0))  # refuses gravity and a pivot shift
    grid = _Grid(parameters, angles[0], np.tile(speeds, len(stiffness)), np.repeat(stiffness, len(speeds)))
    served = grid.fill(accuracy, progress or (lambda share: None))
    shape = (len(stiffness), len(speeds))
    return StabilityMap(speeds, stiffness, grid.found.reshape(shape), grid.errors.reshape(shape), served, accuracy)


class _Grid:
    """The points of a map, each with the number of steps it is tried with next."""

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
        self.found = np.full(len(speed), np.nan)
        self.errors = np.full(len(speed), np.nan)

    def first_rung(self, accuracy: float) -> NDArray[np.intp]:
        """Index into the ladder of steps to begin with; beyond its end: not a case for explicit steps.

        Fitted: the finer of n/2 and n steps meets the accuracy when its step is 1.0 radian of the fastest
        undamped rate at an accuracy of 1e-8 and a span of 20 radians, and falls with the ninth root of both.
        """
        mass = self.parameters.total_mass_kg
        fast = np.sqrt(self.rigs[:, :2] / mass)
        damped = np.maximum(self.parameters.zeta1, self.parameters.zeta2)
        swing = np.pi * np.maximum(np.max(fast, axis=1), 1.0)
        stiff = np.pi * np.maximum(np.max(self.rigs[:, 4:], axis=1), 2 * damped * np.max(fast, axis=1))
        length = 1.0 * (accuracy / 1e-8 * 20.0 / swing) ** (1 / 9)
        steps = np.maximum(swing / length, stiff / 2.5)
        return np.searchsorted(np.array(_LADDER), steps)

    def fill(self, accuracy: float, progress: Callable[[float], None]) -> str:
        """Compute every point; says how many points each method served."""
        rung = self.first_rung(accuracy)
        both = self.parameters.a.present and self.parameters.b.present
        if not both:
            rung[:] = len(_LADDER)
        open_points = np.ones(len(rung), bool)
        with ThreadPoolExecutor(max_workers=_cores()) as pool:
            for i in range(len(_LADDER)):
                here = np.flatnonzero(open_points & (rung == i))
                for batch in self._explicit(pool, here, _LADDER[i]):
                    met = self.errors[batch] <= accuracy * np.maximum(1.0, self.found[batch])
                    open_points[batch[met]] = False
                    rung[batch[~met]] = self._next_rung(i, batch[~met], accuracy)
                    progress(float(1 - open_points.mean()))
        quick = int(np.count_nonzero(~open_points))
        for point in np.flatnonzero(open_points):
            self._one(int(point), accuracy)
            open_points[point] = False
            progress(float(1 - open_points.mean()))
        return f"explicit, {LANES} points at once: {quick}; point by point: {len(rung) - quick}"

    def _next_rung(self, i: int, points: NDArray[np.intp], accuracy: float) -> NDArray[np.intp]:
        """Where points go that missed the accuracy with ladder[i] steps: the error falls with the eighth power."""
        wanted = accuracy * np.maximum(1.0, self.found[points])
        factor = np.nan_to_num((self.errors[points] / wanted) ** (1 / 8), nan=2.0, posinf=2.0)
        return np.maximum(i + 1, np.searchsorted(np.array(_LADDER), _LADDER[i] * np.minimum(1.1 * factor, 4.0)))

    def _explicit(self, pool: ThreadPoolExecutor, points: NDArray[np.intp], steps: int) -> Iterable[NDArray[np.intp]]:
        """Run points with one number of steps on all cores; yields each batch when it is done."""
        if len(points) == 0:
            return
        fine = node_table(self.parameters, *self.angles, steps)
        coarse = node_table(self.parameters, *self.angles, steps // 2)
        size = max(LANES, min(_BATCH, -(-len(points) // (2 * LANES)) * LANES))
        pending = {}
        for start in range(0, len(points), size):
            batch = points[start : start + size]
            found, errors = np.empty(len(batch)), np.empty(len(batch))
            arguments = (fine, coarse, self.rigs[batch], self.length_m, self.parameters.total_mass_kg, found, errors)
            pending[pool.submit(largest_multipliers, *arguments)] = (batch, found, errors)
        for future in as_completed(pending):
            future.result()
            batch, found, errors = pending[future]
            self.found[batch], self.errors[batch] = found, errors
            yield batch

    def _one(self, point: int, accuracy: float) -> None:
        """One point by whatever method serves it."""
        p = self.parameters
        rig = dataclasses.replace(p, k2_N_per_m=float(self.stiffness_ratios[point]) * p.k1_N_per_m)
        speed = float(self.speed_ratios[point]) * p.natural_frequencies_rad_s[0]
        matrix = type_one(rig, *self.angles, speed)
        for looser in (1.0, 1e2, 1e4, 1e6):
            try:
                answer = floquet_multipliers(matrix, min(looser * accuracy, 0.1))
            except NotConverged as refusal:
                last = refusal
            else:
                self.found[point], self.errors[point] = answer.largest, answer.error_estimate
                return
        where = f"Ω = {self.speed_ratios[point]:.6g}, K = {self.stiffness_ratios[point]:.6g}"
        raise NotConverged(f"stability map at {where}: {last}; leave this point out") from last


def _cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
