"""Maps of basins: how long they take, and whether an independent integrator ends each release at the same place.

Every case is a map of 60 × 40 releases, each followed for up to 20 s. The referee has its own equations (a 4 × 4 mass
matrix, solved numerically) and its own integrator (heyoka to 1e-15, or SciPy's DOP853 to 1e-10), and a simple mind: it
follows a release until the state once a revolution repeats to 1e-6, and calls that its end; a pendulum that still turns
against the rotor after 400 s slips, and its mean rate is held against the one claimed. A cell that is claimed not to
have settled must be farther from each stable state than arrived ones are when its time is over.

    uv run python -m benchmarks.basins --cells 200 --json basins.json

Times are those of the second map: the first compiles. `processor` is the time of all threads together, which other
programs on the machine leave as it is.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynamics import RotorParameters
from dynamics.bench.heyoka_runs import available, compiled
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins.basin_map import BasinMap, basins
from dynamics.steady.basins.ends import NEAR_RAD
from rig_configs import load_rig

_GRID, _SECONDS = (60, 40), 20.0
_BLOCK = 50  # revolutions the referee takes at a time
_REPEATS = 1e-6  # rad, of a locked motion from one revolution to the next
_SAME = 1e-3  # rad, of the referee's angles and the claimed ones
_TURNING_S = 400.0  # after which what still turns is called slipping
_LOOKED_AT = 0.5  # of that time, over which its rate is taken
_SAME_RATE = 1e-5  # turns per revolution


@dataclass(frozen=True)
class Case:
    """A map: its name, a point or speed ratio, and settings laid over the virtual rig."""

    name: str
    place: str | float
    settings: tuple[str, ...] = ()


_WEAK = ("pendulums.a.damping_Nms_per_rad=1e-4", "pendulums.b.damping_Nms_per_rad=1e-4")
_DAMPED = ("suspension.zeta1=0.05", "suspension.zeta2=0.05")
CASES = (
    *(Case(point, point) for point in "ABCDE"),
    Case("D, ζ 0.05", "D", _DAMPED),
    Case("B, c3 = c4 = 1e-4", "B", _WEAK),
    Case("E, c3 = c4 = 1e-4", "E", _WEAK),
)


class Referee:
    """The motion of a rig by other means: the state once a revolution."""

    def __init__(self, p: RotorParameters, speed: float, by_scipy: bool) -> None:
        self.p, self.speed, self.period = p, speed, 2 * math.pi / speed
        self.by_scipy = by_scipy
        if not by_scipy:
            self._taylor = compiled(False, 1e-15).__copy__()
            self._taylor.pars[:] = np.array([*p.packed()[:12], speed])

    def strobe(self, state: np.ndarray, revolutions: int) -> np.ndarray:
        """States after each revolution, the first included, shape (revolutions + 1, 8)."""
        instants = np.arange(revolutions + 1) * self.period
        if not self.by_scipy:
            self._taylor.time = 0.0
            self._taylor.state[:] = state
            return self._taylor.propagate_grid(instants)[5].copy()
        from scipy.integrate import solve_ivp  # half a second, and only where heyoka is absent

        run = solve_ivp(self._rates, (0.0, instants[-1]), state, "DOP853", instants, rtol=1e-10, atol=1e-13)
        return run.y.T

    def _rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """(x, y, θ3, θ4) from their 4 × 4 mass matrix at constant speed."""
        p, w = self.p, self.speed
        mass, force = np.zeros((4, 4)), np.zeros(4)
        mass[0, 0] = mass[1, 1] = p.total_mass_kg
        k, c = (p.k1_N_per_m, p.k2_N_per_m), p.damping_Ns_per_m
        force[:2] = [-k[i] * y[i] - c[i] * y[4 + i] for i in range(2)]
        force[:2] += p.imbalance_moment_kg_m * w * w * np.array([math.cos(w * t), math.sin(w * t)])
        for i, q in enumerate((p.a, p.b)):
            phi, rate, s = w * t + y[2 + i], w + y[6 + i], q.first_moment_kg_m
            force[:2] += s * rate * rate * np.array([math.cos(phi), math.sin(phi)])
            mass[0, 2 + i] = mass[2 + i, 0] = -s * math.sin(phi)
            mass[1, 2 + i] = mass[2 + i, 1] = s * math.cos(phi)
            mass[2 + i, 2 + i] = q.inertia_kg_m2
            force[2 + i] = -q.damping_Nms_per_rad * y[6 + i]
        return np.concatenate([y[4:], np.linalg.solve(mass, force)])


def judged(found: BasinMap, referee: Referee, cell: tuple[int, int]) -> str:
    """One cell's claim against the referee's end: "right", or what is wrong."""
    p, speed, period = referee.p, referee.speed, referee.period
    start = locked_state(p, speed, 0.0, found.theta3_rad[cell[1]], found.theta4_rad[cell[0]])
    horizon = math.ceil(found.seconds / period)
    claim = int(found.end[cell])
    track = referee.strobe(start, horizon)
    if claim < 0:
        near = [_gap(track[-1], end.start) for end in found.ends if end.slipping is None]
        return "right" if min(near, default=1.0) > NEAR_RAD else "WRONG: not settled, but it is"
    end = found.ends[claim]
    while len(track) * period < _TURNING_S:
        if np.max(np.ptp(track[-_BLOCK:, 2:4], axis=0)) < _REPEATS:
            if end.slipping is not None:
                return "WRONG: slipping, but it locks"
            right = _gap(track[-1], end.start) < _SAME
            return "right" if right else f"WRONG: {end.words}, but it locks at {np.degrees(track[-1, 2:4]) % 360}"
        state = track[-1]
        track = np.concatenate([track, referee.strobe(state, _BLOCK)[1:]])
    if end.slipping is None:
        return f"WRONG: {end.words}, but it does not lock"
    late = track[int(len(track) * (1 - _LOOKED_AT)) :, 2:4]
    window = np.exp(-1.0 / ((t := (np.arange(len(late) - 1) + 0.5) / (len(late) - 1)) * (1 - t)))
    rates = window @ np.diff(late, axis=0) / window.sum() / (2 * math.pi)
    off = float(np.max(np.abs(rates - np.array(end.slipping.turns_per_revolution))))
    return "right" if off < _SAME_RATE else f"WRONG: slipping at another rate, by {off:.2g}"


def _gap(state: np.ndarray, other: np.ndarray) -> float:
    return float(np.max(np.abs(np.exp(1j * state[2:4]) - np.exp(1j * other[2:4]))))


def timed(case: Case) -> tuple[BasinMap, RotorParameters, float, float]:
    """A case's map with the seconds of wall clock and of all processors."""
    rig = load_rig("virtual", settings=case.settings)
    p = rig.physics
    speed = p.speed_rad_s(rig.points[case.place].speed_ratio if isinstance(case.place, str) else case.place)
    three, four = (
        begin + (np.arange(n) + 0.5) * 2 * math.pi / n for n, begin in zip(_GRID, (-math.pi, 0), strict=True)
    )
    wall, processor = time.perf_counter(), time.process_time()
    found = basins(p, speed, three, four, _SECONDS)
    return found, p, time.perf_counter() - wall, time.process_time() - processor


def held_against(found: BasinMap, p: RotorParameters, cells: int, seed: int, by_scipy: bool) -> Counter[str]:
    """Verdicts on cells outside the stated boundary, drawn at random."""
    sure = np.argwhere(found.sure)
    rng = np.random.default_rng(seed)
    drawn = sure[rng.choice(len(sure), min(cells, len(sure)), replace=False)]
    workers = os.cpu_count() or 1

    def share(part: np.ndarray) -> list[str]:
        referee = Referee(p, found.speed_rad_s, by_scipy)
        return [judged(found, referee, (int(i), int(j))) for i, j in part]

    with ThreadPoolExecutor(workers) as pool:
        return Counter(verdict for part in pool.map(share, np.array_split(drawn, workers)) for verdict in part)


def row(case: Case, cells: int, seed: int, by_scipy: bool) -> dict[str, Any]:
    """One case measured."""
    found, p, wall, processor = timed(case)
    verdicts = held_against(found, p, cells, seed, by_scipy)
    return {
        "case": case.name,
        "wall_s": wall,
        "processor_s": processor,
        "releases": found.end.size,
        "ends": [
            {"end": e.words, "share": s, "multiplier": e.multiplier}
            for e, s in zip(found.ends, found.shares.tolist(), strict=False)
        ],
        "not_settled_share": float(found.shares[-1]),
        "at_a_boundary_share": 1 - float(found.sure.mean()),
        "held_against_cells": sum(verdicts.values()),
        "verdicts": dict(verdicts),
    }


def _print(one: dict[str, Any]) -> None:
    right = one["verdicts"].get("right", 0)
    print(
        f"{one['case']}: {one['wall_s']:.1f} s ({one['processor_s']:.1f} s of processor), not settled "
        f"{100 * one['not_settled_share']:.1f} %, at a boundary {100 * one['at_a_boundary_share']:.1f} %, "
        f"{right} of {one['held_against_cells']} as the referee has it"
    )
    for end in one["ends"]:
        print(f"    {100 * end['share']:5.1f} %  {end['end']}  (multiplier {end['multiplier']:.4f})")
    for verdict, count in one["verdicts"].items():
        if verdict != "right":
            print(f"    {count} × {verdict}")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=200, help="held against the referee, of each map")
    parser.add_argument("--cases", nargs="*", help="names; all without")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scipy", action="store_true", help="SciPy's DOP853 as the referee, not heyoka")
    parser.add_argument("--json", type=Path, help="write the results there")
    asked = parser.parse_args(arguments)
    by_scipy = asked.scipy or not available()
    rig = load_rig("virtual")
    basins(rig, 20.0, [0.1], [3.0], 0.5)  # compiles
    rows = list[dict[str, Any]]()
    for case in CASES:
        if asked.cases and case.name not in asked.cases:
            continue
        rows.append(row(case, asked.cells, asked.seed, by_scipy))
        _print(rows[-1])
        if asked.json is not None:
            asked.json.write_text(json.dumps({"cores": os.cpu_count(), "cases": rows}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
