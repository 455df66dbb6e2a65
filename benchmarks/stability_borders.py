"""Borders of stability against a map by brute force and multipliers by scipy; their time; families over damping.

    python -m benchmarks.stability_borders [--columns 4000] [--rows 3000] [--zeta 0.005 0.02 0.1] [--every 10]

For each damping the borders over Ω = 0.3 … 7, K = 1 … 16, as `rig map --borders` gives them, joined by straight lines,
are held against the signs of a map of columns × rows points along all of its rows and columns (`lines_on_maps`), its
four sides included. Every n-th point of the borders is held against multipliers over a whole revolution by scipy and
numpy alone (`independent_multipliers`): whether the largest is the border's own and has the modulus 1, how far the
point is off the border, whether it is stable on the left hand and not on the right, and whether stability is lost as
the border states.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent_multipliers import multipliers
from benchmarks.lines_on_maps import compare
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.borders import DIVERGENCE, DOUBLING, FLUTTER, Border, Borders, stability_borders
from dynamics.stability.map_plane import SpeedStiffnessPlane
from dynamics.stability.stability_map import stability_map
from rig_configs import load_rig

Array = NDArray[np.floating]
X_RANGE, Y_RANGE = (0.3, 7.0), (1.0, 16.0)
_BLOCK = 100  # rows of the map at a time
_BEYOND = 1e-9  # of the range: by which borders are drawn beyond the sides on which they end
_ASIDE = 1e-7  # of the range: where stability is looked for on both sides of a border


def against_map(parameters: RotorParameters, found: Borders, columns: int, rows: int) -> list[str]:
    """Borders against a map of the same range."""
    x, y = np.linspace(*X_RANGE, columns), np.linspace(*Y_RANGE, rows)
    stable = np.empty((rows, columns), bool)
    began = time.process_time()
    for start in range(0, rows, _BLOCK):
        stable[start : start + _BLOCK] = stability_map(parameters, x, y[start : start + _BLOCK]).multiplier_max < 1
    took = time.process_time() - began
    lines = [_beyond_the_sides(branch) for branch in found.branches]
    return [
        f"map of {columns} × {rows}, {took:.1f} s of processor; stable share {stable.mean():.6f} against "
        f"{found.stable_share:.6f}",
        f"  along rows: {compare(stable, x, y, lines)}",
        f"  along columns: {compare(stable.T, y, x, [(b, a) for a, b in lines])}",
    ]


def _beyond_the_sides(branch: Border) -> tuple[Array, Array]:
    """A branch's points with its ends a little longer: a line that ends on a side crosses it."""
    if branch.closed:
        return branch.x, branch.y
    x, y = (np.concatenate([[2 * v[0] - v[1]], v, [2 * v[-1] - v[-2]]]) for v in (branch.x, branch.y))
    for values, span in ((x, X_RANGE), (y, Y_RANGE)):
        slack = _BEYOND * (span[1] - span[0])
        values[[0, -1]] = np.clip(values[[0, -1]], span[0] - slack, span[1] + slack)
    return x, y


@dataclasses.dataclass
class Checked:
    """Points of borders against independent multipliers: largest differences, and how many are wrong."""

    points: int = 0
    modulus: float = 0.0
    multiplier: float = 0.0
    off_in_speed: float = 0.0
    wrong_sides: int = 0
    wrong_kinds: int = 0

    def __str__(self) -> str:
        return (
            f"{self.points} points by scipy: largest | |μ| − 1 | {self.modulus:.1e}, border's multiplier off by "
            f"{self.multiplier:.1e}, {self.off_in_speed:.1e} in Ω off the border; {self.wrong_sides} stable on the "
            f"wrong side, {self.wrong_kinds} of another kind"
        )


def against_scipy(parameters: RotorParameters, branches: tuple[Border, ...], every: int) -> Checked:
    """Every n-th point of borders against multipliers by scipy and numpy."""
    found = Checked()
    for branch in branches:
        x, y, own = branch.x[1:-1:every], branch.y[1:-1:every], branch.multiplier[1:-1:every]
        there = multipliers(parameters, x, y)
        found.points += len(x)
        found.modulus = max(found.modulus, float(np.max(np.abs(np.abs(there[:, 0]) - 1))))
        first = np.where(there[:, 0].imag < 0, there[:, 0].conj(), there[:, 0])
        found.multiplier = max(found.multiplier, float(np.max(np.abs(first - own))))
        kinds = np.array([_kind(value) for value in first])
        found.wrong_kinds += int(np.sum(kinds != np.array(branch.kind)[1:-1:every]))
        left, right = (np.abs(multipliers(parameters, *place)[:, 0]) - 1 for place in _both_sides(branch, every))
        found.wrong_sides += int(np.sum(~((left < 0) & (right > 0))))
        off = (np.abs(there[:, 0]) - 1) / (right - left) * 2 * _ASIDE * (X_RANGE[1] - X_RANGE[0])
        found.off_in_speed = max(found.off_in_speed, float(np.max(np.abs(off))))
    return found


def _both_sides(branch: Border, every: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Places a little to the left and to the right of the points."""
    wide, high = X_RANGE[1] - X_RANGE[0], Y_RANGE[1] - Y_RANGE[0]
    at = branch.x / wide + 1j * branch.y / high
    ways = at[2::every] - at[:-2:every]
    aside = 1j * _ASIDE * ways / np.abs(ways)
    (left_x, left_y), (right_x, right_y) = (
        (branch.x[1:-1:every] + side * aside.real * wide, branch.y[1:-1:every] + side * aside.imag * high)
        for side in (1, -1)
    )
    return (left_x, left_y), (right_x, right_y)


def _kind(multiplier: complex) -> str:
    if abs(multiplier.imag) > 1e-6:
        return FLUTTER
    return DIVERGENCE if multiplier.real > 0 else DOUBLING


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=4000)
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--zeta", type=float, nargs="*", default=[0.005, 0.02, 0.1])
    parser.add_argument("--every", type=int, default=10, help="which points are held against scipy; 0: none")
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
        print(f"  curves off by up to {max(b.off for b in found.branches):.1e} of the range", flush=True)
        if args.every:
            print(f"  {against_scipy(parameters, found.branches, args.every)}", flush=True)
        if args.columns and args.rows:
            print("  " + "\n  ".join(against_map(parameters, found, args.columns, args.rows)), flush=True)
    began = time.perf_counter(), time.process_time()
    for zeta in np.geomspace(0.005, 0.1, args.family):
        parameters = dataclasses.replace(nominal, zeta1=float(zeta), zeta2=float(zeta))
        stability_borders(SpeedStiffnessPlane(parameters, balanced_angles(parameters)[0]), X_RANGE, Y_RANGE)
    took = time.perf_counter() - began[0], time.process_time() - began[1]
    print(f"a family of {args.family} dampings: {took[0]:.1f} s wall, {took[1]:.1f} s of processor")


if __name__ == "__main__":
    main()
