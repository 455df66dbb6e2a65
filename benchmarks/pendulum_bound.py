"""Pendulum damping against its bound: spin-down, friction, release, tracking.

    python -m benchmarks.pendulum_bound [--runs N] [--quick] [--only spin-down|release|tracking|speed] [--cell N]

Readings come from closed forms and from `benchmarks.independent_rig` (DOP853 on its own equations), never from the
models that are fitted. The bound is the numerical Fisher information of the readings as white noise of step/√12 and
jitter together; for a jitter-free encoder it is no bound at all, and ratios below one are possible. Damping and start
speed are drawn ±10 % around their cell, because where in a step a pendulum comes to rest is a matter of luck that a
fixed design would repeat in every run. Seeds are (run, cell) and printed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.independent_rig import Encoders, release_run
from benchmarks.tracking_speed import print_speeds
from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification import IdentificationError
from identification.pendulums.release import fit_release
from identification.pendulums.spin_down import fit_spin_down
from identification.pendulums.suspension_knowledge import Knowledge
from identification.setting import Setting
from identification.tracking.replay import track
from rig_configs.load import load_rig

INERTIA = 2.187e-4
SPEED = 2 * np.pi * 5
DAMPINGS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
JITTERS = (0.0, 0.3)
NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")


@dataclass
class Cell:
    """What many runs of one setting gave."""

    relative: list[float] = field(default_factory=list)
    bound: list[float] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    claimed: list[float] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)
    friction: list[bool] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failed: int = 0

    def line(self) -> str:
        rms = float(np.sqrt(np.mean(np.square(self.relative))))
        bound = float(np.sqrt(np.mean(np.square(self.bound)))) if self.bound else np.nan
        claimed = float(np.sqrt(np.mean(np.square(self.claimed))))
        out = f"{rms:9.2e}{rms / bound:7.2f}{rms / claimed:7.2f}{np.mean(self.covered):8.3f}"
        out += f"{np.mean(self.found):8.3f}" if self.found else " " * 8
        out += f"{np.mean(self.friction):8.3f}" if self.friction else " " * 8
        return out + f"{self.failed:6d}{1e3 * np.median(self.seconds):8.0f}"


def run_down(
    damping: float, speed: float, share: float, encoders: Encoders, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Eight time constants, at most ten seconds, of a pendulum already in motion; dry friction as a share of c v0."""
    rate = damping / INERTIA
    t = np.arange(0, min(10.0, 8 / rate), 1e-3)
    t = t[rng.random(len(t)) > encoders.lost]
    s = np.minimum(t, np.log1p(1 / share) / rate) if share else t
    angle = rng.uniform(0, 6) + speed * ((1 + share) / rate * (1 - np.exp(-rate * s)) - share * s)
    return t, encoders.read(angle, rng)


def run_down_bound(t: np.ndarray, damping: float, speed: float, share: float, noise: float, span: float) -> float:
    """Relative bound of c on the readings of the first `span` time constants, by central differences."""
    rate = damping / INERTIA
    t = t[t < span / rate]

    def angle(p: np.ndarray) -> np.ndarray:
        s = np.minimum(t, np.log1p(1 / p[3]) / p[2]) if share else t
        h = p[3] if share else 0.0
        return p[0] + p[1] * ((1 + h) / p[2] * (1 - np.exp(-p[2] * s)) - h * s)

    at, columns = np.array([0.0, speed, rate, share]), []
    for i in range(4 if share else 3):
        step = np.zeros(4)
        step[i] = 1e-5 * (abs(at[i]) or 1.0)
        columns.append((angle(at + step) - angle(at - step)) / (2 * step[i]))
    jacobian = np.column_stack(columns)
    return float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[2, 2])) * noise / rate


def spin_downs(runs: int, setting: Setting, only: int | None) -> None:
    print(
        f"\nSpin-down, {setting}: rms and std relative to c; bound over five time constants; found = friction reported"
    )
    print(
        f"{'c':>7}{'jitter':>7}{'share':>8}{'rms':>9}{'/bound':>7}{'/std':>7}{'cover':>8}{'found':>8}{'cov Mc':>8}"
        f"{'fail':>6}{'ms':>8}"
    )
    cells = [(c, j, s) for c in DAMPINGS for j in JITTERS for s in (0.0, 1e-3)]
    for number, (damping, jitter, share) in enumerate(cells):
        if only is not None and number != only:
            continue
        cell, encoders = Cell(), Encoders(jitter=jitter)
        noise = encoders.step_rad * np.sqrt(1 / 12 + jitter**2)
        for k in range(runs):
            rng = np.random.default_rng([k, number])
            c, v0 = damping * rng.uniform(0.9, 1.1), SPEED * rng.uniform(0.9, 1.1)
            t, angle = run_down(c, v0, share, encoders, rng)
            began = time.perf_counter()
            try:
                fit = fit_spin_down(t, angle, INERTIA, setting=setting)
            except IdentificationError:
                cell.failed += 1
                continue
            cell.seconds.append(time.perf_counter() - began)
            low, high = fit.intervals["c_Nms_per_rad"]
            cell.relative.append(fit.values["c_Nms_per_rad"] / c - 1)
            cell.claimed.append(fit.std["c_Nms_per_rad"] / c)
            cell.bound.append(run_down_bound(t, c, v0, share, noise, 5.0))
            cell.covered.append(low < c < high)
            cell.found.append("coulomb_Nm" in fit.values)
            if cell.found[-1]:
                low, high = fit.intervals["coulomb_Nm"]
                cell.friction.append(low < share * c * v0 < high)
        print(f"{damping:7.0e}{jitter:7.1f}{share:8.0e}{cell.line()}   seeds (0…{runs - 1}, {number})", flush=True)


def release_case(
    damping: float, jitter: float, seed: tuple[int, int], wrong: float, imbalance_std: float, zero_std: float
) -> tuple[RotorParameters, Run, Knowledge]:
    """Truth, readings and what is known of it: k to 0.1 %, ζ to 1 %, damping wrong by a factor either way."""
    rng, base = np.random.default_rng(seed), load_rig("virtual").physics
    truth = base.with_values(**{n: damping * np.exp(0.1 * rng.normal()) for n in NAMES})
    run = release_run(truth, 8.0, rng, Encoders(jitter=jitter), zero_std * rng.normal(size=2))
    log_std = np.array([1e-3, 1e-3, 1e-2, 1e-2, imbalance_std])
    true = truth.identified()
    known = {
        n: true[n] * np.exp(s * rng.normal())
        for n, s in zip(("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m"), log_std, strict=True)
    }
    known |= {n: true[n] * wrong ** float(rng.choice([-1, 1])) for n in NAMES}
    return truth, run, Knowledge(truth.with_values(**known), log_std)


def releases(runs: int, setting: Setting, only: int | None) -> None:
    print(f"\nRelease at 8 Hz, {setting}: damping ten times wrong at the start, S_P known to 20 %, encoder zeros to 2°")
    print(f"{'c':>7}{'jitter':>7}{'rms':>9}{'':7}{'/std':>7}{'cover':>8}{'converged':>16}{'fail':>6}{'ms':>8}")
    for number, (damping, jitter) in enumerate((c, j) for c in (1e-4, 1e-3, 3e-3, 1e-2) for j in JITTERS):
        if only is not None and number != only:
            continue
        cell, converged = Cell(), 0
        for k in range(runs):
            zero_std = np.radians(2.0)
            truth, run, known = release_case(damping, jitter, (k, 100 + number), 10.0, 0.2, zero_std)
            began = time.perf_counter()
            try:
                fit = fit_release(run, known, zero_std, setting=setting)
            except IdentificationError:
                cell.failed += 1
                continue
            cell.seconds.append(time.perf_counter() - began)
            true = truth.identified()
            converged += all(abs(fit.values[n] - true[n]) < 5 * fit.std[n] for n in NAMES)
            for n in NAMES:
                cell.relative.append(fit.values[n] / true[n] - 1)
                cell.claimed.append(fit.std[n] / true[n])
                cell.covered.append(fit.intervals[n][0] < true[n] < fit.intervals[n][1])
        line = cell.line()
        print(
            f"{damping:7.0e}{jitter:7.1f}{line[:9]}{'':7}{line[16:31]}{converged / runs:16.3f}{line[47:]}"
            f"   seeds (0…{runs - 1}, {100 + number})",
            flush=True,
        )


def trackings(runs: int, only: int | None) -> None:
    print("\nTracking a release: S_P known to 1 %, zeros to 0.05°; at the end of 8 s")
    print(f"{'c':>7}{'wrong':>7}{'median error':>14}{'cover':>8}{'trusted':>9}{'s':>8}")
    cells = [(c, w) for c in (1e-4, 1e-3, 1e-2) for w in (1.5, 10.0)]
    for number, (damping, wrong) in enumerate(cells):
        if only is not None and number != only:
            continue
        errors, covered, trusted, seconds = [], [], [], []
        for k in range(runs):
            truth, run, known = release_case(damping, 0.3, (k, 200 + number), wrong, 0.01, np.radians(0.05))
            began = time.perf_counter()
            last = track(run, known.physics, imbalance_std=0.01).last
            seconds.append(time.perf_counter() - began)
            true = truth.identified()
            trusted.append(last.trusted)
            for n in NAMES:
                errors.append(abs(last.values[n] / true[n] - 1))
                covered.append(last.intervals[n][0] < true[n] < last.intervals[n][1])
        print(
            f"{damping:7.0e}{wrong:7.1f}{np.median(errors):14.3f}{np.mean(covered):8.3f}{np.mean(trusted):9.3f}"
            f"{np.median(seconds):8.2f}   seeds (0…{runs - 1}, {200 + number})",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="pendulum damping against its bound")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--quick", action="store_true", help="20 runs a cell")
    parser.add_argument("--only", choices=("spin-down", "release", "tracking", "speed"))
    parser.add_argument("--cell", type=int, help="one cell of the table")
    parser.add_argument("--setting", choices=("fast", "balanced", "reference"), default="balanced")
    given = parser.parse_args()
    runs = 20 if given.quick else given.runs
    parts: dict[str, Callable[[], None]] = {
        "spin-down": lambda: spin_downs(runs, given.setting, given.cell),
        "release": lambda: releases(runs, given.setting, given.cell),
        "tracking": lambda: trackings(max(20, runs // 5), given.cell),
        "speed": print_speeds,
    }
    for name, part in parts.items():
        if given.only in (None, name):
            part()


if __name__ == "__main__":
    main()
