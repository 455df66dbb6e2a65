"""A map of multipliers against what else computes them, in one run: GNU Octave with the source's schemes, and heyoka.

    python -m benchmarks.stability_peers [--columns 400] [--rows 300] [--repeats 5] [--sample 200] [--json FILE]

The map, Ω = 0.3 … 7 × K = 1 … 16 at an accuracy of 1e-8, is timed as a whole and divided by its points. Octave runs
the single pass (ode45 at 1e-8, all eight columns) and the piecewise constant matrix with 100 and 400 parts at the
points A to E (benchmarks/stability_schemes.m); heyoka, Taylor series of the variational equations in double precision,
runs on points of the map on as many cores. The true error of each is against heyoka in 80 bits, or against thirty
digits of mpmath where heyoka is not installed. A ratio is the peer's median time over the map's, per point; the one of
processor times does not depend on who else is using the machine's cores, or on how many of them the map used.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import os
import platform
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynamics.bench import heyoka_runs, mpmath_peer
from dynamics.bench.heyoka_runs import Rig
from dynamics.compiled_code import keep_compiled_code
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.floquet.multipliers import balanced
from dynamics.stability.stability_map import StabilityMap, stability_map
from rig_configs import load_rig

X_RANGE, Y_RANGE, ACCURACY = (0.3, 7.0), (1.0, 16.0), 1e-8
_SCHEMES = Path(__file__).with_name("stability_schemes.m")
_SEED = 20261126
_SLOW_SAMPLE = 12  # points that thirty digits are asked for: seconds each


@dataclass(frozen=True)
class Row:
    """One way to a multiplier.

    Attributes:
        what, points: which way, on which points.
        wall_s, processor_s: median time per point.
        error: largest true error relative to max(1, modulus); NaN where no reference could be had.
    """

    what: str
    points: str
    wall_s: float
    processor_s: float
    error: float


def _timed(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median wall and processor seconds of a call, after one that is not counted."""
    work()
    taken: list[tuple[float, float]] = []
    for _ in range(repeats):
        began = time.perf_counter(), time.process_time()
        work()
        taken.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    return statistics.median(wall for wall, _ in taken), statistics.median(own for _, own in taken)


def _true(rig: Rig) -> float | None:
    """The largest multiplier of a rig's balanced state, far more exact than anything measured here."""
    if heyoka_runs.available():
        return heyoka_runs.largest_multiplier(rig, heyoka_runs.EXTENDED_TOLERANCE)
    return mpmath_peer.largest_multiplier(balanced(type_one(rig[0], *balanced_angles(rig[0])[0], rig[1])))


def _worst(found: list[float], true: list[float | None]) -> float:
    """Largest error against the references that there are."""
    errors = [heyoka_runs.relative(value, t) for value, t in zip(found, true, strict=True) if t is not None]
    return max(errors, default=float("nan"))


def _map_rows(parameters: RotorParameters, columns: int, rows: int, repeats: int, sample: int) -> list[Row]:
    """The map, and heyoka on some of its points."""
    x, y, count = np.linspace(*X_RANGE, columns), np.linspace(*Y_RANGE, rows), columns * rows
    found: StabilityMap = stability_map(parameters, x, y, ACCURACY)
    wall, processor = _timed(lambda: stability_map(parameters, x, y, ACCURACY), repeats)
    places: NDArray[np.int64] = np.random.default_rng(_SEED).choice(count, min(sample, count), replace=False)
    judged = places if heyoka_runs.available() else places[:_SLOW_SAMPLE]
    rigs: list[Rig] = []
    for row, column in (divmod(int(place), columns) for place in judged):
        rig = dataclasses.replace(parameters, k2_N_per_m=float(y[row]) * parameters.k1_N_per_m)
        rigs.append((rig, parameters.speed_rad_s(float(x[column]))))
    true = [_true(rig) for rig in rigs]
    error = _worst(found.multiplier_max.ravel()[judged].tolist(), true)
    result = [Row("the map", f"{columns} × {rows}", wall / count, processor / count, error)]
    if heyoka_runs.available():
        tolerance = 2.2e-16
        integrator = heyoka_runs.compiled(True, tolerance)

        def run() -> list[float]:
            return heyoka_runs.on_all_cores(
                lambda own, i: heyoka_runs.largest_multiplier(rigs[i], tolerance, own), integrator, len(rigs)
            )

        wall, processor = _timed(run, repeats)
        points = f"{len(rigs)} of them"
        result.append(Row("heyoka", points, wall / len(rigs), processor / len(rigs), _worst(run(), true)))
    return result


def _octave_rows(points: dict[str, Rig], repeats: int) -> list[Row]:
    """The source's schemes in GNU Octave, medians over the points, none where it is not installed."""
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        return []
    true = [_true(rig) for rig in points.values()]
    with tempfile.TemporaryDirectory() as place:
        table = Path(place) / "points.csv"
        with table.open("w", newline="", encoding="utf-8") as out:
            csv.writer(out).writerows(_numbers(*rig) for rig in points.values())
        done = subprocess.run(
            [octave, "--norc", "--quiet", str(_SCHEMES), str(table), str(repeats)],
            capture_output=True,
            text=True,
            check=True,
            timeout=3600,
        )
    measured: dict[str, list[tuple[int, float, float, float]]] = {}
    for point, scheme, parts, value, wall, processor in csv.reader(done.stdout.splitlines()):
        name = f"Octave, {scheme}" + (f", N = {parts}" if int(parts) else "")
        measured.setdefault(name, []).append((int(point), float(value), float(wall), float(processor)))
    result: list[Row] = []
    for name, lines in measured.items():
        error = _worst([value for _, value, _, _ in lines], [true[point] for point, _, _, _ in lines])
        wall, processor = (statistics.median(line[i] for line in lines) for i in (2, 3))
        result.append(Row(name, ", ".join(points), wall, processor, error))
    return result


def _numbers(parameters: RotorParameters, speed_rad_s: float) -> list[str]:
    """A point as stability_schemes.m reads it."""
    a, b = parameters.a, parameters.b
    numbers = [
        parameters.total_mass_kg,
        parameters.k1_N_per_m,
        parameters.k2_N_per_m,
        *parameters.damping_Ns_per_m,
        a.first_moment_kg_m,
        b.first_moment_kg_m,
        a.inertia_kg_m2,
        b.inertia_kg_m2,
        a.damping_Nms_per_rad,
        b.damping_Nms_per_rad,
        *balanced_angles(parameters)[0],
        speed_rad_s,
    ]
    return [repr(float(number)) for number in numbers]


@dataclass(frozen=True)
class Comparison:
    """One run.

    Attributes:
        rows: the map first.
        load: of the machine, before and after.
        notes: what is missing, and why.
    """

    rows: list[Row]
    load: tuple[float, float]
    notes: list[str]

    def as_json(self) -> dict[str, object]:
        """Everything, with ratios to the map."""
        own = self.rows[0]
        rows = [
            dataclasses.asdict(row)
            | {"wall_ratio": row.wall_s / own.wall_s, "processor_ratio": row.processor_s / own.processor_s}
            for row in self.rows
        ]
        machine = {"system": platform.platform(), "cores": os.cpu_count(), "load_before_and_after": self.load}
        return {"accuracy": ACCURACY, "machine": machine, "rows": rows, "notes": self.notes}

    def table(self) -> str:
        """Everything, to be read."""
        own, (before, after) = self.rows[0], self.load
        lines = [
            f"{os.cpu_count()} cores, load {before:.1f} before and {after:.1f} after; per point, ratios to the map",
            f"{'':28} {'points':16} {'wall':>11} {'processor':>11} {'error':>8} {'ratio':>11} {'processor':>11}",
        ]
        lines += [
            f"{row.what:28} {row.points:16} {1e6 * row.wall_s:8.4g} µs {1e6 * row.processor_s:8.4g} µs "
            f"{row.error:8.1e} {row.wall_s / own.wall_s:11,.0f} {row.processor_s / own.processor_s:11,.0f}"
            for row in self.rows
        ]
        return "\n".join([*lines, *self.notes])


def compare(columns: int, rows: int, repeats: int, sample: int) -> Comparison:
    """Measure everything."""
    rig, before = load_rig("virtual"), os.getloadavg()[0]
    found = _map_rows(rig.physics, columns, rows, repeats, sample)
    points = {name: (rig.physics, rig.physics.speed_rad_s(point.speed_ratio)) for name, point in rig.points.items()}
    octave = _octave_rows(points, max(1, repeats // 2))
    notes: list[str] = []
    if not octave:
        notes.append("GNU Octave is not installed: the source's schemes are left out (Debian: apt-get install octave)")
    if not heyoka_runs.available():
        notes.append("heyoka is not installed (Linux only): left out, and errors are against thirty digits of mpmath")
    return Comparison([*found, *octave], (before, os.getloadavg()[0]), notes)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=400)
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--sample", type=int, default=200)
    parser.add_argument("--json", type=Path, help="write all of it to a file")
    args = parser.parse_args()
    keep_compiled_code()
    found = compare(args.columns, args.rows, args.repeats, args.sample)
    print(found.table())
    if args.json is not None:
        args.json.write_text(json.dumps(found.as_json(), indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
