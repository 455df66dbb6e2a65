"""Ring-down against the Cramér–Rao bound: efficiency, bias, coverage, gross failures, damage, close pairs, time.

    python -m benchmarks.ring_down_bound [--runs N] [--quick] [--only PART …] [--setting fast|balanced|reference]

Signals are made sample by sample in closed form, masks and rails included; the fits average blocks and know nothing of
it. Bounds come from the numerical Fisher information of all samples, with the same unknowns. Errors are divided by each
run's own bound, so frequencies, phases and angles are drawn anew in every run. Seeds are fixed and printed. Parts: one,
gross, pair, unresolved, damage, settings, time, peers.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.ring_down_peers import compare_peers
from identification import IdentificationError, fit_ring_down
from identification.setting import Setting

SEED = 20261
SETTINGS: tuple[Setting, ...] = ("fast", "balanced", "reference")
RATIO_STD = 2e-3  # what the fit may know about the sensors' gains


def wave(t: np.ndarray, f: float, zeta: float, amplitude: float, phase: float) -> np.ndarray:
    """A decaying oscillation, sample by sample."""
    w = 2 * np.pi * f
    return amplitude * np.exp(-zeta * w * t) * np.cos(w * np.sqrt(1 - zeta**2) * t + phase)


def two_axes(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Sensors x and y; q = f1, ζ1, f2, ζ2, β, ln ρ, a1, φ1, a2, φ2, offset x, offset y. Shape (n, 2)."""
    x, y = wave(t, q[0], q[1], q[6], q[7]), wave(t, q[2], q[3], q[8], q[9])
    cos, sin = np.cos(q[4]), np.sin(q[4])
    return np.column_stack([cos * x + sin * y + q[10], np.exp(q[5]) * (-sin * x + cos * y) + q[11]])


def one_axis(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """One sensor; q = f, ζ, a, φ, offset. Shape (n,)."""
    return wave(t, *q[:4]) + q[4]


def bound(
    signal: Callable[[np.ndarray, np.ndarray], np.ndarray],
    t: np.ndarray,
    q: np.ndarray,
    sigma: float,
    known: dict[int, float] | None = None,
) -> np.ndarray:
    """Standard deviations that no unbiased estimator beats, by central differences of the signal itself.

    Args:
        known: place in q → standard deviation of prior knowledge.
    """  # fmt: skip
    steps = 1e-6 * np.maximum(np.abs(q), 1e-4)
    # the derivative by f grows with time: a step small against 1/T and by ζ likewise
    jacobian = np.column_stack(
        [
            (signal(t, q + h * e) - signal(t, q - h * e)).ravel() / (2 * h)
            for h, e in zip(steps, np.eye(len(q)), strict=True)
        ]
    )
    scale = np.linalg.norm(jacobian, axis=0) + 1e-300
    information = (jacobian / scale).T @ (jacobian / scale) / sigma**2
    for place, std in (known or {}).items():
        information[place, place] += 1 / (std * scale[place]) ** 2
    return np.sqrt(np.diag(np.linalg.inv(information))) / scale


@dataclass
class Tally:
    """Errors in units of the bound, whether intervals covered, failures, remarks."""

    errors: list[list[float]]
    covered: list[list[bool]]
    failed: int = 0
    said: int = 0

    def row(self, names: list[str]) -> str:
        z, c = np.array(self.errors), np.array(self.covered)
        if len(z) == 0:
            return f"all {self.failed} failed"
        efficiency = 1 / np.mean(z**2, axis=0)
        parts = [
            f"{n} {e:5.2f} {b:+.2f} {100 * k:5.1f}"
            for n, e, b, k in zip(names, efficiency, z.mean(axis=0), c.mean(axis=0), strict=True)
        ]
        return f"{' | '.join(parts)} | worst {np.abs(z).max():4.1f} failed {self.failed} not resolved {self.said}"


def tally(
    runs: int, draw: Callable[[np.random.Generator], tuple], names: list[str], seed: int, setting: Setting = "balanced"
) -> Tally:
    """Fit drawn signals. `draw` gives (time, signal, truth by name, bound by name)."""  # fmt: skip
    out = Tally([], [])
    for k in range(runs):
        t, signal, true, floor = draw(np.random.default_rng([SEED, seed, k]))
        try:
            fit = fit_ring_down(t, signal, setting=setting)
        except IdentificationError as error:
            out.failed += 1
            if out.failed < 3:
                print(f"      run {k}: {error}")
            continue
        out.said += not fit.axes_resolved or any("not resolved" in w for w in fit.warnings)
        if any(n not in fit.values for n in names):
            out.failed += 1
            continue
        out.errors.append([(fit.values[n] - true[n]) / floor[n] for n in names])
        out.covered.append([fit.intervals[n][0] <= true[n] <= fit.intervals[n][1] for n in names])
    return out


def one_mode(zeta: float, relative_noise: float, record_s: float = 20.0, rate: float = 1000.0) -> Callable:
    """A drawn frequency and phase at a given damping ratio and noise; zeta or noise of 0 draws them too."""

    def draw(rng: np.random.Generator) -> tuple:
        t = np.arange(round(record_s * rate)) / rate
        damping = zeta or float(np.exp(rng.uniform(np.log(1e-4), np.log(0.2))))
        sigma = 1e-3 * (relative_noise or float(np.exp(rng.uniform(np.log(1e-3), np.log(1e-1)))))
        q = np.array([rng.uniform(2.5, 12), damping, 1e-3, rng.uniform(0, 2 * np.pi), 1e-3 * rng.normal()])
        floor = bound(one_axis, t, q, sigma)
        y = one_axis(t, q) + sigma * rng.normal(size=len(t))
        return t, y, {"f1_Hz": q[0], "zeta1": q[1]}, {"f1_Hz": floor[0], "zeta1": floor[1]}

    return draw


PAIR = ["f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg"]


def pair(f: float, zeta: float, split: float, sigma: float, record_s: float, other_zeta: float = 1.0) -> Callable:
    """Two modes `split` half-bandwidths apart, seen by sensors turned by up to 20°."""

    def draw(rng: np.random.Generator) -> tuple:
        t = np.arange(round(record_s * 1000)) / 1000
        half = zeta * f * split * (-1 if split < 2 and rng.random() < 0.5 else 1)
        q = np.array(
            [f, zeta, f + half, zeta * other_zeta, np.radians(rng.uniform(-20, 20)), 0.0, 1e-3, rng.uniform(0, 6.28),
             1e-3 * rng.uniform(0.4, 1), rng.uniform(0, 6.28), 1e-4, -2e-4]
        )  # fmt: skip
        floor = bound(two_axes, t, q, sigma, {5: RATIO_STD, 4: np.radians(30)})
        signal = two_axes(t, q) + sigma * rng.normal(size=(len(t), 2))
        unit = np.array([1, 1, 1, 1, np.degrees(1)])
        return t, signal, dict(zip(PAIR, q[:5] * unit, strict=True)), dict(zip(PAIR, floor[:5] * unit, strict=True))

    return draw


RESOLVED = {
    "3 and 5 Hz, ζ 0.01, 10 µm, 20 s": pair(3, 0.01, 200 / 3, 1e-5, 20),
    "3 and 11.6 Hz, ζ 0.02, 4 µm, 12 s": pair(3, 0.02, 143.3, 4e-6, 12),
    "3 and 11.6 Hz, ζ 0.2, 10 µm, 5 s": pair(3, 0.2, 14.33, 1e-5, 5),
    "split 1, ζ 0.001, 10 µm, 60 s": pair(3, 0.001, 1.0, 1e-5, 60),
    "split 1, ζ 0.05, 10 µm, 20 s": pair(3, 0.05, 1.0, 1e-5, 20),
    "split 0.3, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.3, 3e-6, 20),
    "split 0.15, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.15, 3e-6, 20),
    "split 0.12, ζ 0.001, 1 µm, 60 s": pair(6, 0.001, 0.12, 1e-6, 60),
    "split 0.12, ζ 0.1, 1 µm, 10 s": pair(8, 0.1, 0.12, 1e-6, 10),
    "same f, ζ 0.01 and 0.02, 10 µm, 20 s": pair(4, 0.01, 0.0, 1e-5, 20, 2.0),
}
UNRESOLVED = {
    "split 0.08, ζ 0.01, 1 µm, 20 s": pair(3, 0.01, 0.08, 1e-6, 20),
    "split 0.05, ζ 0.01, 3 µm, 20 s": pair(3, 0.01, 0.05, 3e-6, 20),
    "split 0.05, ζ 0.05, 10 µm, 20 s": pair(5, 0.05, 0.05, 1e-5, 20),
    "split 0.02, ζ 0.001, 10 µm, 60 s": pair(3, 0.001, 0.02, 1e-5, 60),
    "split 0, ζ 0.01, 10 µm, 20 s": pair(3, 0.01, 0.0, 1e-5, 20),
    "split 0, ζ 0.2, 10 µm, 20 s": pair(6, 0.2, 0.0, 1e-5, 20),
}


def _bursts(rng: np.random.Generator, n: int, share: float, length: int) -> np.ndarray:
    lost = np.zeros(n, bool)
    while lost.mean() < share:
        at = rng.integers(n)
        lost[at : at + 1 + rng.geometric(1 / length)] = True
    return lost


def damaged(kind: str, zeta: float, sigma: float = 1e-5, rail: float = 5e-3) -> Callable:
    """One mode of which 5 % of the samples are spoilt, or 8 mm of motion on a ±5 mm sensor; the bound is the clean
    record's."""

    def draw(rng: np.random.Generator) -> tuple:
        t, n = np.arange(20000) / 1000, 20000
        amplitude = 8e-3 if kind.startswith("clip") else 1e-3
        q = np.array([rng.uniform(2.5, 8), zeta, amplitude, rng.uniform(0, 6.28), 0.0])
        floor = bound(one_axis, t, q, sigma)
        clean = one_axis(t, q)
        noise = sigma * rng.normal(size=n)
        y = clean + noise
        spikes, gaps = rng.random(n) < 0.05, _bursts(rng, n, 0.05, 30)
        if kind == "outliers":
            y[spikes] = rng.uniform(-rail, rail, int(spikes.sum()))
        elif kind == "bursts to the rail":
            y[gaps] = rail
        elif kind == "bursts to zero":
            y[gaps] = 0.0
        elif kind == "bursts, last value held":
            y = y[np.maximum.accumulate(np.where(gaps, 0, np.arange(n)))]
        elif kind == "NaN":
            y[gaps] = np.nan
        elif kind == "clip":
            y = np.clip(y, -rail, rail)
        elif kind == "clip, noise after it":
            y = np.clip(clean, -rail, rail) + noise
        elif kind == "wander 20 µm at 0.11 Hz":
            y += 2e-5 * np.sin(2 * np.pi * 0.11 * t + rng.uniform(0, 6.28))
        elif kind == "1 µm steps":
            y = np.round(y / 1e-6) * 1e-6
        return t, y, {"f1_Hz": q[0], "zeta1": q[1]}, {"f1_Hz": floor[0], "zeta1": floor[1]}

    return draw


DAMAGE = [
    (kind, zeta)
    for kind in ("outliers", "bursts to the rail", "bursts to zero", "bursts, last value held", "NaN", "clip",
                 "clip, noise after it", "wander 20 µm at 0.11 Hz", "1 µm steps")
    for zeta in ((1e-4, 0.01, 0.2) if not kind.startswith("clip") else (0.001, 0.01, 0.2))
]  # fmt: skip


def timings() -> None:
    """Processor time, medians of seven: 60 s at 1 and at 10 kHz, one and two channels."""
    rng = np.random.default_rng([SEED, 9])
    for rate in (1000, 10000):
        t = np.arange(60 * rate) / rate
        q = np.array([3, 0.01, 5, 0.01, 0.1, 0.0, 1e-3, 0.3, 7e-4, 1.0, 0.0, 0.0])
        both = two_axes(t, q) + 1e-5 * rng.normal(size=(len(t), 2))
        spoilt = both.copy()
        spoilt[rng.random(spoilt.shape) < 0.05] = 5e-3
        single = one_axis(t, np.array([3, 0.01, 1e-3, 0.3, 0.0])) + 1e-5 * rng.normal(size=len(t))
        for setting in SETTINGS:
            row = []
            for signal in (single, both, spoilt):
                seconds = []
                for _ in range(7):
                    began = time.process_time()
                    fit_ring_down(t, signal, setting=setting)
                    seconds.append(time.process_time() - began)
                row.append(np.median(seconds))
            print(
                f"  {rate:6} Hz {setting:10} one channel {1e3 * row[0]:5.0f} ms (two: {2e3 * row[0]:5.0f})  "
                f"joint {1e3 * row[1]:5.0f} ms  with 5 % outliers {1e3 * row[2]:5.0f} ms"
            )


def settings(runs: int) -> None:
    """What each setting costs and gives."""
    print("Settings, ζ 0.01, σ/a 0.01")
    for each in SETTINGS:
        began = time.process_time()
        done = tally(runs, one_mode(0.01, 0.01), ["f1_Hz", "zeta1"], 400, each)
        spent = 1e3 * (time.process_time() - began) / runs
        print(f"  {each:10} {spent:5.1f} ms a run with its bound {done.row(['f1_Hz', 'zeta1'])}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=1000, help="Monte-Carlo runs per cell")
    parser.add_argument("--quick", action="store_true", help="60 runs per cell")
    parser.add_argument("--only", nargs="*", default=[], help="parts to run")
    parser.add_argument("--setting", default="balanced", choices=("fast", "balanced", "reference"))
    options = parser.parse_args()
    runs, setting = 60 if options.quick else options.runs, options.setting
    print(f"seed {SEED}, {runs} runs a cell, setting {setting}. Columns: efficiency, bias / bound, coverage %.")
    parts = options.only or ["one", "gross", "pair", "unresolved", "damage", "settings", "time", "peers"]
    names = ["f1_Hz", "zeta1"]
    if "one" in parts:
        print("One mode, 20 s, f 2.5 to 12 Hz and phase drawn")
        for i, zeta in enumerate((1e-4, 1e-3, 0.01, 0.05, 0.2)):
            for j, noise in enumerate((1e-3, 1e-2, 1e-1)):
                done = tally(runs, one_mode(zeta, noise), names, 10 * i + j, setting)
                print(f"  ζ {zeta:<6g} σ/a {noise:<6g} {done.row(names)}", flush=True)
    if "gross" in parts:
        done = tally(10 * runs, one_mode(0, 0), names, 100, setting)
        z = np.array(done.errors)
        print(f"Gross failures in {10 * runs} draws: {done.failed + int(np.sum(np.any(np.abs(z) > 8, axis=1)))}")
        print(f"  {done.row(names)}", flush=True)
    for part, cells in (("pair", RESOLVED), ("unresolved", UNRESOLVED)):
        if part in parts:
            print(f"Two axes jointly, {part}, axis angle ±20°")
            for i, (label, draw) in enumerate(cells.items()):
                done = tally(runs, draw, PAIR, 200 + i + 50 * (part == "unresolved"), setting)
                print(f"  {label:40} {done.row(PAIR)}", flush=True)
    if "damage" in parts:
        print("Damage (bound of the clean record; rms/bound = efficiency^-1/2)")
        for i, (kind, zeta) in enumerate(DAMAGE):
            done = tally(runs, damaged(kind, zeta), names, 300 + i, setting)
            print(f"  {kind:26} ζ {zeta:<6g} {done.row(names)}", flush=True)
    if "settings" in parts:
        settings(runs)
    if "time" in parts:
        print("Processor time, 60 s, medians of 7")
        timings()
    if "peers" in parts:
        print("Peers on the same data: bias of ζ, rms/bound of ζ [of f], median time")
        compare_peers(max(20, runs // 10), SEED, lambda z, s, rng: one_mode(z, s)(rng))


if __name__ == "__main__":
    main()
