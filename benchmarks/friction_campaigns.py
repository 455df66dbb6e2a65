"""Dry friction in spin-downs, releases and all of them together, on readings that know nothing of this project.

    python -m benchmarks.friction_campaigns [--draws 20] [--seed 1] [--only none,torque,contact,both] [--limit 1e-6]

Each campaign draws a rig (damping 3e-4 … 3e-3 N m s/rad, springs ± 10 %), friction of one kind (a torque of 1e-6 …
1e-3 N m, a contact part of 1e-9 … 1e-5 kg m², both, none), encoders (8 to 16 bits, 0 to 1 step of jitter, 0 to 5 % of
the samples lost, 500 to 2000 Hz), and records a spin-down and releases at three speeds by
`benchmarks.independent_friction`. Suspension and imbalance are known as ring-downs and a run-up know them. Printed for
c3, c4 by the spin-down alone, each release alone and all together: refused share, mean and spread of z, the largest,
the share within 1.96, the median of std/c, the share of fits that claim friction, the seconds.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.independent_friction import Dry, swings
from benchmarks.independent_rig import Encoders
from daq.signals.run import Release, Run
from identification import IdentificationError, fit_release, fit_spin_down_run, identify
from identification.estimate import Estimate
from identification.identify import Identification
from identification.pendulums.suspension_knowledge import Knowledge
from rig_configs import load_rig
from rig_configs.parameters_file import IdentifiedParameters

C = ("c3_Nms_per_rad", "c4_Nms_per_rad")
SUSPENSION = {"k1_N_per_m": 1e-4, "k2_N_per_m": 1e-4, "zeta1": 2e-3, "zeta2": 2e-3, "SP_kg_m": 1e-3}
SPEEDS_Hz = (4.8, 7.8, 17.4)
ZERO_STD = np.radians(0.05)
MASS_KG, ARM_KG_M, ARM_KG_M2 = 7.27, 0.075 * 0.054, 0.075 * 0.054**2


@dataclass
class Drawn:
    """One rig, its friction and its encoders."""

    rng: np.random.Generator
    kind: str
    limit: float | None = None

    def __post_init__(self) -> None:
        draw = self.rng.uniform
        self.k = np.array([2583.07, 38487.79]) * (1 + 0.1 * draw(-1, 1, 2))
        self.zeta = 0.02 * 10 ** draw(-0.3, 0.3, 2)
        self.c = 1e-3 * 10 ** draw(-0.5, 0.5, 2)
        self.moment = 0.120 * 0.02117 * (1 + 0.03 * draw(-1, 1))
        self.encoders = Encoders(
            2 * np.pi / 2 ** self.rng.integers(8, 17),
            float(self.rng.choice([500, 1000, 2000])),
            float(self.rng.choice([0.0, 0.3, 1.0])),
            0.05 * draw() ** 2,
        )
        torque = 10 ** draw(-6, -3) * (1 + 0.2 * draw(-1, 1, 2))
        contact = 10 ** draw(-9, -5 if self.limit is None else np.log10(self.limit)) * (1 + 0.2 * draw(-1, 1, 2))
        if self.limit is not None:
            torque *= min(1.0, self.limit * 100 / 1e-3)
        none = np.zeros(2)
        self.dry = Dry(
            tuple(torque if self.kind in ("torque", "both") else none),
            tuple(contact if self.kind in ("contact", "both") else none),
        )
        self.zero = ZERO_STD * self.rng.normal(size=2)

    @property
    def truth(self) -> dict[str, float]:
        return dict(zip((*SUSPENSION, *C), [*self.k, *self.zeta, self.moment, *self.c], strict=True))

    def numbers(self, speed: float, phase: float) -> np.ndarray:
        damping = 2 * self.zeta * np.sqrt(self.k * MASS_KG)
        pair = [ARM_KG_M, ARM_KG_M, self.moment, ARM_KG_M2, ARM_KG_M2]
        return np.array([MASS_KG, *self.k, *damping, *pair, *self.c, speed, phase])

    def _read(self, time_s: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        keep = self.rng.random(len(time_s)) > self.encoders.lost
        return time_s[keep], self.encoders.read(angle + self.zero, self.rng)[keep]

    def _locks(self) -> np.ndarray:
        return np.radians(np.array([0.0, 180.0]) + self.rng.uniform(-0.2, 0.2, 2))

    def spin_down(self) -> Run:
        p, lock = self.numbers(0.0, self.rng.uniform(-np.pi, np.pi)), self._locks()
        t = np.arange(0, 6.0, 1 / self.encoders.rate_Hz)
        flick = 12 * self.rng.choice([-1, 1], 2) * (1 + 0.2 * self.rng.normal(size=2))
        after = t >= 1.0
        angle = np.tile(lock, (len(t), 1))
        angle[after] = swings(np.r_[0, 0, lock, 0, 0, flick], t[after], p, self.dry)[:, 2:4]
        none = np.empty(0)
        read = self._read(t, angle)
        return Run(
            "spin-down",
            "spin-down.mcap",
            0.0,
            none,
            none,
            none,
            none,
            *read,
            none,
            none,
            angle_step_rad=self.encoders.step_rad,
        )

    def release(self, speed_Hz: float) -> Run:
        speed, psi0, lock = 2 * np.pi * speed_Hz, self.rng.uniform(-np.pi, np.pi), self._locks()
        p, go = self.numbers(speed, psi0), 3.0 + self.rng.uniform(0, 0.2)
        t = np.arange(0, go + 7.0, 1 / self.encoders.rate_Hz)
        whole = self.moment + ARM_KG_M * np.exp(1j * lock).sum()
        x, y = (whole * speed**2 / (p[1 + i] - p[0] * speed**2 + 1j * speed * p[3 + i]) for i in range(2))
        turn = np.exp(1j * (psi0 + speed * go))
        start = np.r_[
            (x * turn).real, (y * turn).imag, lock, (1j * speed * x * turn).real, (1j * speed * y * turn).imag
        ]
        after, angle = t >= go, np.tile(lock, (len(t), 1))
        angle[after] = swings(np.r_[start, 0, 0], np.r_[go, t[after]], p, self.dry)[1:, 2:4]
        turns = 2 * np.pi * np.arange(np.ceil(psi0 / (2 * np.pi)), (psi0 + speed * t[-1]) // (2 * np.pi))
        marks = (turns - psi0) / speed + 1e-6 * self.rng.standard_normal(len(turns))
        release_s, none = go + 5e-4 * self.rng.standard_normal(), np.empty(0)
        return Run(
            f"point-{speed_Hz:g}Hz",
            f"point-{speed_Hz:g}Hz.mcap",
            0.0,
            none,
            none,
            none,
            none,
            *self._read(t, angle),
            marks,
            turns,
            (Release(0, release_s), Release(1, release_s)),
            self.encoders.step_rad,
        )

    def known(self) -> tuple[Estimate, Run]:
        """Suspension and imbalance as other tests have found them, and a run that stands for those."""
        true = self.truth
        std = np.array([s * true[n] for n, s in SUSPENSION.items()])
        values = np.array([true[n] for n in SUSPENSION]) + std * self.rng.normal(size=5)
        none = np.empty(0)
        run = Run("ring-down-x", "known.mcap", 0.0, none, none, none, none, none, np.empty((0, 2)), none, none)
        return Estimate("ring-down-x", ("known.mcap",), tuple(SUSPENSION), values, np.diag(std**2), {}, "known"), run


@dataclass
class Tally:
    """What fits of one kind gave."""

    z: list[float] = field(default_factory=list)
    std: list[float] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    claims: list[bool] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    refused: int = 0
    crashed: int = 0

    def line(self) -> str:
        n = len(self.seconds)
        if not self.z:
            return f"{n:5}{self.refused:8}{self.crashed:8}"
        z = np.array(self.z)
        return (
            f"{n:5}{self.refused:8}{self.crashed:8}{z.mean():8.2f}{z.std():7.2f}{np.abs(z).max():8.2f}"
            f"{np.mean(np.abs(z) < 1.96):9.3f}{np.mean(self.inside) if self.inside else np.nan:8.3f}"
            f"{np.median(self.std):10.1e}{np.mean(self.claims) if self.claims else np.nan:8.2f}"
            f"{np.median(self.seconds):7.2f}{max(self.seconds):7.1f}"
        )


def tally(into: Tally, truth: dict[str, float], ask: Callable[[], tuple], label: str) -> None:
    """One fit counted."""
    began = time.perf_counter()
    try:
        values, std, intervals, claim = ask()
    except IdentificationError as error:
        into.refused += 1
        print(f"    {label}: {error}", flush=True)
        into.seconds.append(time.perf_counter() - began)
        return
    except Exception as error:
        into.crashed += 1
        print(f"    {label}: CRASHED {error!r}", flush=True)
        into.seconds.append(time.perf_counter() - began)
        return
    into.seconds.append(time.perf_counter() - began)
    into.claims += [claim] if claim is not None else []
    for name in C:
        if name not in values:
            into.refused += 1
            continue
        into.z.append((values[name] - truth[name]) / std[name])
        into.std.append(std[name] / values[name])
        if intervals is not None:
            into.inside.append(intervals[name][0] < truth[name] < intervals[name][1])
        if abs(into.z[-1]) > 3.5:
            print(f"    {label}: {name} z {into.z[-1]:.1f}, std {into.std[-1]:.1e}", flush=True)


def _one_fit(fit):
    return fit.values, fit.std, fit.intervals, fit.friction is not None


def campaign(drawn: Drawn, guess, tables: dict[str, Tally], label: str, quick: bool) -> None:
    runs = [drawn.spin_down(), *(drawn.release(s) for s in SPEEDS_Hz)]
    estimate, stands_for = drawn.known()
    found = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    knowledge = Knowledge.nominal(guess.physics).with_found(found, estimate.std)
    tally(tables["spin-down"], drawn.truth, lambda: _one_fit(fit_spin_down_run(runs[0], knowledge)), f"{label} spin")
    for run in [] if quick else runs[1:]:
        tally(
            tables["release"],
            drawn.truth,
            lambda run=run: _one_fit(fit_release(run, knowledge, ZERO_STD)),
            f"{label} {run.test}",
        )
    earlier = Identification(IdentifiedParameters(found, estimate.covariance), 0.0, 1.0, [estimate], [], [], [])

    def all_of(chosen: list[Run], show: bool):
        def ask():
            done = identify([stands_for, *chosen], guess, earlier=earlier)
            if show:
                for warning in done.warnings:
                    print(f"      {warning}", flush=True)
            return (
                done.parameters.values,
                done.parameters.std,
                None,
                any("dry friction in addition to" in w for w in done.warnings),
            )

        return ask

    tally(tables["all"], drawn.truth, all_of(runs, True), f"{label} all")
    if quick:
        return
    tally(tables["spin-down + one release"], drawn.truth, all_of([runs[0], runs[-1]], False), f"{label} two")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="none,torque,contact,both")
    parser.add_argument("--limit", type=float, help="largest contact part drawn, kg m²; the torque with it")
    parser.add_argument("--quick", action="store_true", help="the spin-down alone and all together")
    given = parser.parse_args()
    print(f"seeds ({given.seed}, {given.first}…{given.first + given.draws - 1})")
    head = f"{'':34}{'n':>5}{'refused':>8}{'crashed':>8}{'mean z':>8}{'sd z':>7}{'max |z|':>8}{'|z|<1.96':>9}"
    head += f"{'inside':>8}{'std/c':>10}{'claims':>8}{'s':>7}{'max s':>7}"
    tables: dict[str, dict[str, Tally]] = {}
    for kind in given.only.split(","):
        tables[kind] = defaultdict(Tally)
        for number in range(given.first, given.first + given.draws):
            rng = np.random.default_rng([given.seed, number, len(kind)])
            drawn = Drawn(rng, kind, given.limit)
            wrong = {
                f"pendulums.{n}.damping_Nms_per_rad": float(drawn.c[i] * 2 ** rng.uniform(-1, 1))
                for i, n in enumerate("ab")
            }
            guess = load_rig("virtual", settings=wrong)
            bits = round(np.log2(2 * np.pi / drawn.encoders.step_rad))
            print(
                f"  {kind} {number}: M {drawn.dry.torque_Nm[0]:.1e}, F {drawn.dry.contact_kg_m2[0]:.1e}, "
                f"{bits} bits, {drawn.encoders.rate_Hz:.0f} Hz, jitter {drawn.encoders.jitter:g}, c {drawn.c[0]:.1e} "
                f"{drawn.c[1]:.1e}",
                flush=True,
            )
            campaign(drawn, guess, tables[kind], f"{kind} {number}", given.quick)
        print(head)
        for name, table in tables[kind].items():
            print(f"{kind + ': ' + name:34}{table.line()}", flush=True)


if __name__ == "__main__":
    main()
