"""Ring-down against the Cramér–Rao bound: efficiency, bias, coverage, gross failures, damage, close pairs, time.

    python -m benchmarks.ring_down_bound [--runs N] [--quick] [--only PART …] [--setting fast|balanced|reference]

Signals are made sample by sample in closed form, masks and rails included; the fits average blocks and know nothing of
it. Bounds come from the numerical Fisher information of all samples, with the same unknowns. Errors are divided by each
run's own bound, so frequencies, phases and angles are drawn for every run. Seeds are fixed and printed. Parts: one,
gross, pair, unresolved, damage, settings, time, peers.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import numpy as np

from benchmarks.ring_down_peers import compare_peers
from benchmarks.ring_down_signals import DAMAGE, PAIR, RESOLVED, UNRESOLVED, Draw, damaged, one_axis, one_mode, two_axes
from identification import IdentificationError, fit_ring_down
from identification.setting import Setting

SEED = 20261
SETTINGS: tuple[Setting, ...] = ("fast", "balanced", "reference")


@dataclass
class Tally:
    """Errors in units of the bound, whether intervals covered, failures, remarks.

    Attributes:
        errors: over the bound, [run][name].
        of_left: over the bound of what damage left, [run][name].
        of_value: over the value, [run][name].
        covered: [run][name].
    """

    errors: list[list[float]] = field(default_factory=list)
    of_left: list[list[float]] = field(default_factory=list)
    of_value: list[list[float]] = field(default_factory=list)
    covered: list[list[bool]] = field(default_factory=list)
    failed: int = 0
    unresolved: int = 0

    def row(self, names: list[str]) -> str:
        z, c = np.array(self.errors), np.array(self.covered)
        if len(z) == 0:
            return f"all {self.failed} failed"
        efficiency = 1 / np.mean(z**2, axis=0)
        parts = [
            f"{n} {e:5.2f} {b:+.2f} {100 * k:5.1f}"
            for n, e, b, k in zip(names, efficiency, z.mean(axis=0), c.mean(axis=0), strict=True)
        ]
        return f"{' | '.join(parts)} | worst {np.abs(z).max():4.1f} failed {self.failed} not resolved {self.unresolved}"

    def damage_row(self, names: list[str]) -> str:
        """Rms over both bounds and bias in per cent of the value, besides."""
        if not self.errors:
            return self.row(names)
        clean, left = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (self.errors, self.of_left))
        bias, runs = 100 * np.mean(self.of_value, axis=0), np.sqrt(len(self.of_value))
        own = 100 * np.std(self.of_value, axis=0) / runs
        parts = [
            f"{n} {c:4.2f} {k:4.2f} {b:+8.4f} ± {o:.4f} %"
            for n, c, k, b, o in zip(names, clean, left, bias, own, strict=True)
        ]
        return f"{' | '.join(parts)} || {self.row(names)}"


def tally(runs: int, draw: Draw, names: list[str], seed: int, setting: Setting = "balanced") -> Tally:
    """Fit drawn signals."""
    out = Tally()
    for k in range(runs):
        drawn = draw(np.random.default_rng([SEED, seed, k]))
        try:
            fit = fit_ring_down(drawn.time_s, drawn.signal_m, setting=setting)
        except IdentificationError as error:
            out.failed += 1
            if out.failed < 3:
                print(f"      run {k}: {error}")
            continue
        out.unresolved += not fit.axes_resolved or any("not resolved" in w for w in fit.warnings)
        if any(n not in fit.values for n in names):
            out.failed += 1
            continue
        error = {n: fit.values[n] - drawn.true[n] for n in names}
        out.errors.append([error[n] / drawn.bound[n] for n in names])
        out.of_left.append([error[n] / drawn.left.get(n, drawn.bound[n]) for n in names])
        out.of_value.append([error[n] / drawn.true[n] for n in names])
        out.covered.append([fit.intervals[n][0] <= drawn.true[n] <= fit.intervals[n][1] for n in names])
    return out


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


def peer_signal(zeta: float, noise: float, rng: np.random.Generator) -> tuple:
    """(time, signal, truth, bound) of one mode."""
    drawn = one_mode(zeta, noise)(rng)
    return drawn.time_s, drawn.signal_m, drawn.true, drawn.bound


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
        print("Damage. Columns: rms / bound of the clean record, rms / bound of what was left, bias in % of the value")
        for i, (kind, zeta) in enumerate(DAMAGE):
            done = tally(runs, damaged(kind, zeta), names, 300 + i, setting)
            print(f"  {kind:26} ζ {zeta:<6g} {done.damage_row(names)}", flush=True)
    if "settings" in parts:
        settings(runs)
    if "time" in parts:
        print("Processor time, 60 s, medians of 7")
        timings()
    if "peers" in parts:
        print("Peers on the same data: bias of ζ, rms/bound of ζ [of f], median time")
        compare_peers(max(20, runs // 10), SEED, peer_signal)


if __name__ == "__main__":
    main()
