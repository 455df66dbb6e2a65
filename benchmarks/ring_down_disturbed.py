"""Ring-downs in a laboratory that is not quiet: hum, lines, coloured noise, holds, sensors that hardly move.

    python -m benchmarks.ring_down_disturbed [--runs 60] [--seed 1] [--only CASE …] [--dump]

Each draw is a rig of its own (stiffness ±10 %, ζ 0.003 to 0.03, sensors turned by up to 3°) plucked along one axis by
2 to 5 mm and released. The motion is the closed form of two uncoupled oscillators in the stiffness axes; nothing of the
project's dynamics is used. Printed per case: share refused, share in which a value is of no mode of the rig, and for
the plucked direction the rms error over the stated standard deviation, its rms over the clean record's stated
standard deviation and the share of true values within the stated 95 % intervals; besides, the share of fits whose
warnings name every line.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.signals.run import Run
from identification import IdentificationError, RingDownFit, fit_ring_down_runs
from identification.setting import Setting

MASS_KG = 7.345
NONE = np.empty(0)


@dataclass(frozen=True)
class World:
    """One drawn pluck.

    Attributes:
        time_s: shape (n,).
        motion_m: sensors x and y without noise, shape (n, 2).
        true: by name.
        release_s: of the column.
    """

    time_s: np.ndarray
    motion_m: np.ndarray
    true: dict[str, float]
    release_s: float
    axis: int


def pluck(
    rng: np.random.Generator,
    axis: int,
    rate_Hz: float = 1000.0,
    record_s: float = 12.0,
    held: bool = True,
    stiffness: tuple[float, float] = (2583.0, 38488.0),
) -> World:
    """A rest, a pull and a hold, then free; with held=False the record begins at the release."""
    k = np.array(stiffness) * (1 + 0.1 * rng.uniform(-1, 1, 2))
    omega, zeta = np.sqrt(k / MASS_KG), 0.003 * 10 ** rng.uniform(0, 1, 2)
    release = 1.5 + 0.2 * rng.random() if held else 0.0
    t = np.arange(round((record_s + release) * rate_Hz)) / rate_Hz
    start = rng.uniform(2e-3, 5e-3) * np.where(np.arange(2) == axis, 1.0, 0.03 * rng.normal(size=2))
    pulled = np.clip((t - 0.6) / 0.3, 0, 1)
    motion = (pulled * pulled * (3 - 2 * pulled))[:, None] * start
    free = t >= release
    for i in range(2):
        wave = omega[i] * np.sqrt(1 - zeta[i] ** 2)
        s = t[free] - release
        motion[free, i] = (
            start[i]
            * np.exp(-zeta[i] * omega[i] * s)
            * (np.cos(wave * s) + zeta[i] * omega[i] / wave * np.sin(wave * s))
        )
    beta = np.radians(rng.uniform(-3, 3))
    turn = np.array([[np.cos(beta), np.sin(beta)], [-np.sin(beta), np.cos(beta)]])
    f = omega / (2 * np.pi)
    true = {"f1_Hz": f[0], "zeta1": zeta[0], "f2_Hz": f[1], "zeta2": zeta[1]}
    return World(t, motion @ turn.T + 1e-3 * rng.normal(size=2), true, release, axis)


def spectrum_noise(
    rng: np.random.Generator, n: int, rate_Hz: float, shape: Callable[[np.ndarray], np.ndarray], rms: float
):
    """Gaussian noise of a given spectral density's shape, scaled to an rms over the record; shape (n, 2)."""
    f = np.fft.rfftfreq(2 * n, 1 / rate_Hz)
    own = rng.normal(size=(len(f), 2)) + 1j * rng.normal(size=(len(f), 2))
    out = np.fft.irfft(own * np.sqrt(shape(f))[:, None], axis=0)[:n]
    return rms * out / out.std(axis=0)


def ar1(corner_Hz: float) -> Callable[[np.ndarray], np.ndarray]:
    """White below a corner, falling with 1/f² above."""
    return lambda f: 1 / (1 + (f / corner_Hz) ** 2)


def pink(f: np.ndarray) -> np.ndarray:
    """1/f from 0.05 Hz on."""
    return 1 / np.maximum(f, 0.05)


def building(f: np.ndarray) -> np.ndarray:
    """Broad bands about 8, 17 and 28 Hz on a floor."""
    return 0.02 + sum(1 / (1 + ((f - c) / w) ** 2) for c, w in ((8.0, 1.0), (17.0, 2.0), (28.0, 3.0)))


def line(t, f, rng, amplitudes, wander_Hz=0.0, period_s=9.0):
    """A steady line in both sensors; its frequency may wander."""
    phase = 2 * np.pi * f * t + wander_Hz * period_s * np.sin(2 * np.pi * t / period_s + rng.uniform(0, 6.28))
    return np.column_stack([a * np.cos(phase + rng.uniform(0, 6.28)) for a in amplitudes])


Case = Callable[[World, np.random.Generator], tuple[np.ndarray, list[float]]]


def _clean(w, rng):
    return 0.0, []


def _hum(amplitudes=(30e-6, 20e-6), at=(50.0,), wander=0.0):
    def case(w, rng):
        return sum(line(w.time_s, f, rng, np.array(amplitudes) / (1 + 2 * i), wander) for i, f in enumerate(at)), list(
            at
        )

    return case


def _near(offset_Hz, amplitude=20e-6):
    def case(w, rng):
        f = w.true[f"f{w.axis + 1}_Hz"] + offset_Hz
        return line(w.time_s, f, rng, (amplitude, 0.7 * amplitude)), [f]

    return case


def _double(w, rng):
    f = 2 * w.true[f"f{w.axis + 1}_Hz"]
    return line(w.time_s, f, rng, (20e-6, 12e-6)), [f]


def _coloured(shape, rms):
    def case(w, rng):
        rate = 1 / (w.time_s[1] - w.time_s[0])
        return spectrum_noise(rng, len(w.time_s), rate, shape, rms), []

    return case


def _floor_rings(w, rng):
    """The floor, hit by the release, rings on slower than the column."""
    f, d = rng.uniform(14, 30), rng.uniform(0.05, 0.2)
    s = np.maximum(w.time_s - w.release_s, 0)
    return np.where(w.time_s >= w.release_s, np.exp(-d * s), 0)[:, None] * line(w.time_s, f, rng, (25e-6, 15e-6)), []


CASES: dict[str, tuple[Case, dict]] = {
    "clean": (_clean, {}),
    "clean, no hold": (_clean, {"held": False}),
    "hum 50 Hz 30/20": (_hum(), {}),
    "hum, no hold": (_hum(), {"held": False}),
    "hum 60 Hz + harmonics": (_hum(at=(60.0, 120.0, 180.0)), {}),
    "hum wanders 0.05 Hz": (_hum(wander=0.05), {}),
    "hum 3/2 um": (_hum((3e-6, 2e-6)), {}),
    "hum 300/200 um": (_hum((300e-6, 200e-6)), {}),
    "line 24.3 Hz": (_hum(at=(24.3,)), {}),
    "line 7.1 Hz": (_hum(at=(7.1,)), {}),
    "line f+0.4 Hz": (_near(0.4), {}),
    "line f-0.15 Hz": (_near(-0.15), {}),
    "line at 2 f": (_double, {}),
    "500 Hz, line 470 aliased": (_hum(at=(30.0,)), {"rate_Hz": 500.0}),
    "10 kHz, hum": (_hum(), {"rate_Hz": 10000.0}),
    "AR(1) 2 Hz, 10 um": (_coloured(ar1(2.0), 10e-6), {}),
    "AR(1) 20 Hz, 10 um": (_coloured(ar1(20.0), 10e-6), {}),
    "AR(1) 20 Hz, 30 um": (_coloured(ar1(20.0), 30e-6), {}),
    "1/f 1 um": (_coloured(pink, 1e-6), {}),
    "1/f 10 um": (_coloured(pink, 10e-6), {}),
    "1/f 30 um": (_coloured(pink, 30e-6), {}),
    "1/f 10 um, no hold": (_coloured(pink, 10e-6), {"held": False}),
    "building bands 3 um": (_coloured(building, 3e-6), {}),
    "building bands 15 um": (_coloured(building, 15e-6), {}),
    "floor rings on": (_floor_rings, {}),
}


def drawn(name: str, seed: int, number: int) -> tuple[World, Run, list[float]]:
    """One recorded run of a case."""
    case, options = CASES[name]
    rng = np.random.default_rng([seed, 77, number])
    world = pluck(rng, number % 2, **options)
    extra, lines = case(world, rng)
    signal = world.motion_m + extra + 4e-6 * rng.normal(size=world.motion_m.shape)
    t = world.time_s
    run = Run(
        f"ring-down-{'xy'[world.axis]}",
        f"draw {number}",
        0.0,
        t,
        signal[:, 0],
        t,
        signal[:, 1],
        NONE,
        NONE.reshape(0, 2),
        NONE,
        NONE,
    )
    return world, run, lines


def fitted(run: Run, number: int, dump: bool, setting: Setting = "balanced") -> RingDownFit | None:
    """Return the fit of one run; None if it is refused, which is printed on request."""
    try:
        return fit_ring_down_runs([run], MASS_KG, setting=setting)
    except IdentificationError as error:
        if dump:
            print(f"    {number} refused: {error}")
        return None


def campaign(name: str, runs: int, seed: int, dump: bool) -> str:
    errors, covered, stds, refused, wrong, named, spent = [], [], [], 0, 0, 0, []
    other_z, both = [], 0
    for number in range(runs):
        world, run, lines = drawn(name, seed, number)
        began = time.process_time()
        fit = fitted(run, number, dump)
        if fit is None:
            refused += 1
            continue
        spent.append(time.process_time() - began)
        own = str(world.axis + 1)
        bad = [
            n
            for n in fit.values
            if n in ("f1_Hz", "f2_Hz")
            and abs(fit.values[n] / world.true[n] - 1) > max(0.03, 6 * fit.std[n] / world.true[n])
        ]
        wrong += bool(bad)
        if f"f{own}_Hz" not in fit.values:
            wrong += not bad
            continue
        names = [f"f{own}_Hz", f"zeta{own}"]
        errors.append([(fit.values[n] - world.true[n]) / fit.std[n] for n in names])
        stds.append([fit.std[n] / world.true[n] for n in names])
        covered.append([fit.intervals[n][0] <= world.true[n] <= fit.intervals[n][1] for n in names])
        cross = str(2 - world.axis)
        if f"f{cross}_Hz" in fit.values:
            both += 1
            other_z.append(
                [fit.intervals[n][0] <= world.true[n] <= fit.intervals[n][1] for n in (f"f{cross}_Hz", f"zeta{cross}")]
            )
        warnings = " ".join(fit.warnings)
        named += all(any(f"{f + s:.2f} Hz" in warnings for s in (-0.01, 0, 0.01)) for f in lines) and bool(lines)
        if dump:
            z = [f"{(fit.values[n] - world.true[n]) / fit.std[n]:+.1f}" for n in fit.values if n in world.true]
            print(f"    {number} z {z} chi2 {fit.chi2_per_dof:.3g} {fit.warnings}")
    row = f"refused {refused / runs:4.0%} wrong {wrong / runs:4.0%} "
    if errors:
        z, c, s = np.array(errors), np.array(covered), np.array(stds)
        bias, rms, share = z.mean(axis=0), np.sqrt((z**2).mean(axis=0)), c.mean(axis=0)
        row += f"| bias {bias[0]:+.2f} {bias[1]:+.2f} rms/std {rms[0]:5.2f} {rms[1]:5.2f} "
        row += f"covers {share[0]:4.0%} {share[1]:4.0%} std f {np.median(s[:, 0]):.1e} ζ {np.median(s[:, 1]):.1e} "
        if other_z:
            o = np.mean(other_z, axis=0)
            row += f"| cross {both / runs:4.0%} covers {o[0]:4.0%} {o[1]:4.0%} "
        row += f"| named {named / runs:4.0%} | {1e3 * np.median(spent):4.0f} ms"
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=list(CASES))
    parser.add_argument("--dump", action="store_true", help="print every fit")
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.runs} draws a case")
    for name in options.only:
        print(f"{name:26} {campaign(name, options.runs, options.seed, options.dump)}", flush=True)


if __name__ == "__main__":
    main()
