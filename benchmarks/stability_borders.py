"""Borders of stability against a map by brute force, their time, and families over damping.

    python -m benchmarks.stability_borders [--columns 4000] [--rows 3000] [--family 5]

For each damping the borders over Ω = 0.3 … 7, K = 1 … 16 are held against the signs of a map of columns × rows points,
row by row and column by column: every change of sign must have a border within half a pitch, every border must be a
change of sign unless two of them lie within one pitch, which no such map can show. Points of the borders are held
against single multipliers by an implicit method. Printed besides: processor and wall time, points per border.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.borders import Borders, stability_borders
from dynamics.stability.floquet import floquet_multipliers
from dynamics.stability.map_plane import SpeedStiffnessPlane
from dynamics.stability.stability_map import stability_map
from rig_configs import load_rig

Array = NDArray[np.floating]
X_RANGE, Y_RANGE = (0.3, 7.0), (1.0, 16.0)
_BLOCK = 100  # rows of the map at a time


def _crossings(along: Array, across: Array, value: float) -> Array:
    """Where a line crosses across = value, shape (n,)."""
    off = across - value
    at = np.flatnonzero((off[:-1] < 0) != (off[1:] < 0))
    return along[at] + off[at] / (off[at] - off[at + 1]) * (along[at + 1] - along[at])


def _compared(signs: NDArray[np.bool_], places: Array, borders: Array, pitch: float) -> tuple[float, int]:
    """Largest distance of a change of sign from a border, in pitches; borders that show nowhere."""
    changes = np.flatnonzero(signs[1:] != signs[:-1])
    middles = (places[changes] + places[changes + 1]) / 2
    if len(middles) and not len(borders):
        return np.inf, 0
    far = max((float(np.min(np.abs(borders - m))) for m in middles), default=0.0) / pitch
    inside = borders[(borders > places[0]) & (borders < places[-1])]
    unseen = [b for b in inside if not np.any(np.abs(middles - b) <= 0.51 * pitch)]
    alone = [b for b in unseen if np.count_nonzero(np.abs(inside - b) <= pitch) < 2]
    return far, len(alone)


def _against_map(parameters: RotorParameters, found: Borders, columns: int, rows: int) -> str:
    x, y = np.linspace(*X_RANGE, columns), np.linspace(*Y_RANGE, rows)
    stable = np.empty((rows, columns), bool)
    began = time.process_time()
    for start in range(0, rows, _BLOCK):
        stable[start : start + _BLOCK] = stability_map(parameters, x, y[start : start + _BLOCK]).multiplier_max < 1
    took = time.process_time() - began
    worst, extra = 0.0, 0
    for j in range(1, rows - 1):  # lines end on the sides
        at = np.concatenate([_crossings(b.x, b.y, y[j]) for b in found.branches])
        far, alone = _compared(stable[j], x, np.sort(at), x[1] - x[0])
        worst, extra = max(worst, far), extra + alone
    for i in range(1, columns - 1):
        at = np.concatenate([_crossings(b.y, b.x, x[i]) for b in found.branches])
        far, alone = _compared(stable[:, i], y, np.sort(at), y[1] - y[0])
        worst, extra = max(worst, far), extra + alone
    return (
        f"map of {columns} × {rows}: farthest change of sign {worst:.3f} pitches from a border, {extra} borders that "
        f"it does not show; stable share {stable.mean():.6f} against {found.stable_share:.6f}; "
        f"map {took:.1f} s of processor"
    )


def _exact(parameters: RotorParameters, found: Borders) -> float:
    """Largest | |μ| − 1 | at points of the borders, by an implicit method."""
    worst, angles = 0.0, balanced_angles(parameters)[0]
    for branch in found.branches:
        for x, y in zip(branch.x[::37], branch.y[::37], strict=True):
            rig = dataclasses.replace(parameters, k2_N_per_m=float(y) * parameters.k1_N_per_m)
            speed = float(x) * parameters.natural_frequencies_rad_s[0]
            worst = max(worst, abs(floquet_multipliers(type_one(rig, *angles, speed), 1e-11, "implicit").largest - 1))
    return worst


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=4000)
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--zeta", type=float, nargs="*", default=[0.005, 0.02, 0.1])
    parser.add_argument("--family", type=int, default=5)
    args = parser.parse_args()
    nominal = load_rig("virtual").physics
    stability_borders(SpeedStiffnessPlane(nominal, balanced_angles(nominal)[0]), (1.0, 2.0), (1.0, 2.0))
    for zeta in args.zeta:
        parameters = dataclasses.replace(nominal, zeta1=zeta, zeta2=zeta)
        plane = SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0])
        began = time.perf_counter(), time.process_time()
        found = stability_borders(plane, X_RANGE, Y_RANGE)
        took = time.perf_counter() - began[0], time.process_time() - began[1]
        sizes = ", ".join(f"{len(b.x)} points" + (" closed" if b.closed else "") for b in found.branches)
        print(f"ζ = {zeta:g}: {took[0]:.2f} s wall, {took[1]:.2f} s of processor; {sizes}", flush=True)
        print(f"    largest | |μ| − 1 | on them {_exact(parameters, found):.1e}", flush=True)
        if args.columns and args.rows:
            print(f"    {_against_map(parameters, found, args.columns, args.rows)}", flush=True)
    began = time.perf_counter()
    for zeta in np.geomspace(0.005, 0.1, args.family):
        parameters = dataclasses.replace(nominal, zeta1=float(zeta), zeta2=float(zeta))
        stability_borders(SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0]), X_RANGE, Y_RANGE)
    print(f"a family of {args.family} dampings: {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
