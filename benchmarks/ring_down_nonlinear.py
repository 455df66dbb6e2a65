"""Ring-downs whose spring hardens and whose damping grows with speed, integrated independently of the estimator.

    python -m benchmarks.ring_down_nonlinear [--runs 60] [--seed 1] [--only CASE …] [--setting balanced] [--dump]

Each draw is a rig of its own (stiffness ±10 %, ζ 0.003 to 0.02, sensors turned by up to 3°) plucked along one axis to
2.5 mm, held, and released. Each direction follows

    q̈ + 2 ζ ω q̇ + d2 |q̇| q̇ + ω² (1 + κ q²) q = 0,

integrated by SciPy (DOP853, relative tolerance 1e-10) from the displacement at rest; lasers read it at 2 kHz with 4 µm
of noise, rounded to 0.4 µm. κ is given as the part of stiffness that it adds at 2.5 mm, d2 as the part of ζ that its
equivalent linear damping adds there. Printed per case, of the plucked direction: share refused; rms error over the
stated standard deviation and the share of true values within the stated 95 % intervals, of f and ζ at zero amplitude;
the same coverage of κ and of ζ's slope; share of fits that name the hardening and the damping of the plucked
direction; share that name a term that is not there; share whose verdict is "not adequate"; median time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks.ring_down_disturbed import fitted
from daq.signals.run import Run
from identification.setting import Setting

MASS_KG = 7.345
NONE = np.empty(0)
PULL_M = 2.5e-3
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """What is not linear.

    Attributes:
        stiffness: κ a², the stiffness added at the pull's amplitude, of k.
        damping: the damping ratio added at the pull's amplitude, of ζ.
    """

    stiffness: float = 0.0
    damping: float = 0.0


CASES: dict[str, Case] = {
    "linear": Case(),
    "stiffness +0.3 %": Case(0.003),
    "stiffness +1 %": Case(0.01),
    "stiffness +3 %": Case(0.03),
    "stiffness -1 %": Case(-0.01),
    "damping +5 %": Case(0.0, 0.05),
    "damping +20 %": Case(0.0, 0.2),
    "damping +50 %": Case(0.0, 0.5),
    "+1 %, damping +20 %": Case(0.01, 0.2),
    "+3 %, damping +50 %": Case(0.03, 0.5),
}


@dataclass(frozen=True)
class World:
    """One drawn pluck.

    Attributes:
        true: by name, at zero amplitude.
        axis: plucked direction, 0 or 1.
        cubic_per_m2: κ.
        zeta_slope_per_m: per direction, of the equivalent linear damping.
    """

    run: Run
    true: dict[str, float]
    axis: int
    cubic_per_m2: float
    zeta_slope_per_m: tuple[float, float]


def free_motion(omega: float, zeta: float, cubic: float, drag: float, start_m: float, time_s: Floats) -> Floats:
    """Displacement of one direction released at rest from a displacement, shape of time_s, m."""

    def slope(_t: float, y: Floats) -> list[float]:
        q, v = float(y[0]), float(y[1])
        return [v, -2 * zeta * omega * v - drag * abs(v) * v - omega * omega * (1 + cubic * q * q) * q]

    found = solve_ivp(slope, (0.0, float(time_s[-1])), [start_m, 0.0], "DOP853", time_s, rtol=1e-10, atol=1e-13)
    return found.y[0]


def pluck(rng: np.random.Generator, axis: int, case: Case, rate_Hz: float = 2000.0, free_s: float = 6.0) -> World:
    """A rest, a pull and a hold, then free."""
    k = np.array([2583.0, 38488.0]) * (1 + 0.1 * rng.uniform(-1, 1, 2))
    omega, zeta = np.sqrt(k / MASS_KG), 0.003 * (20 / 3) ** rng.uniform(0, 1, 2)
    cubic = case.stiffness / PULL_M**2
    slope = case.damping * zeta / PULL_M
    start = PULL_M * np.where(np.arange(2) == axis, 1.0, 0.03 * rng.normal(size=2))
    release = 0.8 + 0.2 * rng.random()
    t = np.arange(round((release + free_s) * rate_Hz)) / rate_Hz
    pulled = np.clip((t - 0.3) / 0.2, 0, 1)
    motion = (pulled * pulled * (3 - 2 * pulled))[:, None] * start
    free = t >= release
    since = np.r_[0.0, t[free] - release]
    for i in range(2):
        drag = 0.75 * np.pi * slope[i]
        motion[free, i] = free_motion(omega[i], zeta[i], cubic, drag, start[i], since)[1:]
    beta = np.radians(rng.uniform(-3, 3))
    turn = np.array([[np.cos(beta), np.sin(beta)], [-np.sin(beta), np.cos(beta)]])
    signal = motion @ turn.T + 1e-3 * rng.normal(size=2) + 4e-6 * rng.normal(size=motion.shape)
    signal = 4e-7 * np.round(signal / 4e-7)
    f = omega / (2 * np.pi)
    true = {"f1_Hz": f[0], "zeta1": zeta[0], "f2_Hz": f[1], "zeta2": zeta[1]}
    run = Run(
        f"ring-down-{'xy'[axis]}", "draw", 0.0, t, signal[:, 0], t, signal[:, 1], NONE, NONE.reshape(0, 2), NONE, NONE
    )
    return World(run, true, axis, cubic, (float(slope[0]), float(slope[1])))


def campaign(name: str, runs: int, seed: int, setting: Setting, dump: bool) -> str:
    case, errors, covered, terms, spent = CASES[name], [], [], [], []
    refused = inadequate = hardens = drags = false = cross = crossed = 0
    for number in range(runs):
        world = pluck(np.random.default_rng([seed, 88, number]), number % 2, case)
        began = time.process_time()
        fit = fitted(world.run, number, dump, setting)
        if fit is None:
            refused += 1
            continue
        spent.append(time.process_time() - began)
        own = str(world.axis + 1)
        z = {n: (v - world.true[n]) / fit.std[n] for n, v in fit.values.items() if n in world.true}
        if dump:
            print(f"    {number} {[f'{n} {v:+.1f}' for n, v in z.items()]} χ² {fit.chi2_per_dof:.3g} {fit.warnings}")
        inadequate += fit.verdict.startswith("not adequate")
        named = {(t.direction, kind) for t in fit.nonlinear for kind in t.kinds}
        hardens += (world.axis + 1, "frequency") in named
        drags += (world.axis + 1, "damping") in named
        false += any(not (case.stiffness if kind == "frequency" else case.damping) for _, kind in named)
        inside = {n: fit.intervals[n][0] <= world.true[n] <= fit.intervals[n][1] for n in z}
        other = str(2 - world.axis)
        if f"zeta{other}" in inside:
            cross, crossed = cross + 2, crossed + inside[f"f{other}_Hz"] + inside[f"zeta{other}"]
        if f"f{own}_Hz" not in z:
            continue
        errors.append([z[f"f{own}_Hz"], z[f"zeta{own}"]])
        covered.append([inside[f"f{own}_Hz"], inside[f"zeta{own}"]])
        for term in fit.nonlinear:
            if term.direction == world.axis + 1:
                if "frequency" in term.kinds:
                    off = abs(term.cubic_stiffness_per_m2 - world.cubic_per_m2)
                    terms.append(off < 1.96 * term.cubic_stiffness_std)
                if "damping" in term.kinds:
                    off = abs(term.zeta_slope_per_m - world.zeta_slope_per_m[world.axis])
                    terms.append(off < 1.96 * term.zeta_slope_std)
    if not errors:
        return f"refused {refused / runs:4.0%}"
    z2, share = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(covered, axis=0)
    return (
        f"refused {refused / runs:3.0%} | rms/std {z2[0]:5.2f} {z2[1]:5.2f} covers {share[0]:4.0%} {share[1]:4.0%} "
        f"cross {crossed / max(cross, 1):4.0%} terms {np.mean(terms) if terms else np.nan:4.0%} "
        f"| names f {hardens / runs:4.0%} ζ {drags / runs:4.0%} false {false / runs:5.1%} "
        f"not adequate {inadequate / runs:4.0%} "
        f"| {1e3 * np.median(spent):4.0f} ms"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=list(CASES))
    parser.add_argument("--setting", choices=("fast", "balanced", "reference"), default="balanced")
    parser.add_argument("--dump", action="store_true", help="print every fit")
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.runs} draws a case, {options.setting}")
    for name in options.only:
        row = campaign(name, options.runs, options.seed, options.setting, options.dump)
        print(f"{name:22} {row}", flush=True)


if __name__ == "__main__":
    main()
