"""Coverage on recordings that know nothing of this project: made by the laboratory, kept as csv.

    python -m benchmarks.imported_coverage [--campaigns 40] [--seed 1] [--wide] [--tests ring-down-x,ring-down-y,...]

Each campaign draws a rig (stiffness ±10 %, damping over a decade, imbalance, sensors turned by up to 5°) and records
two ring-downs, a run-up, a spin-down and a release at speed at 1 kHz, with noise, offset, quantised encoders and lost
samples. The csv files are imported and identified with a rig file whose suspension is up to 15 % wrong and whose
dampings are wrong by a factor 2. With --wide the rigs and the recorders leave the ordinary: ζ 0.001 to 0.2, c 1e-4 to
1e-2, sensors turned by up to 20°, 0.5 to 5 kHz, 1 to 30 µm of noise, up to 1 % outliers, 5 % of the encoders' samples
lost, 1024 to 16384 counts, ramps of 25 to 100 s. With --change the phase comes in steps, the point has a
noisy speed in place of it, the pendulums have dry friction (a torque, one that goes with the contact force) or A is
lighter than the rig file states. Printed per parameter: mean and spread of z = (found − true)/std, the
share within 1.96, the largest, and the relative std; the same for each test alone.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.worlds.motion import Mechanics, SwingingMass, Turning, moved
from daq.exchange import import_recording, make_recipe
from identification import IdentificationError, identify
from rig_configs import load_rig
from studies.runs import load_runs

TESTS = ("ring-down-x", "ring-down-y", "run-up", "spin-down", "point")
DISK_KG, PENDULUM_KG, LENGTH_M, WEIGHT_KG = 7.0, 0.075, 0.054, 0.120
MASS_KG = DISK_KG + 2 * PENDULUM_KG + WEIGHT_KG


@dataclass(frozen=True)
class Recorder:
    """How a laboratory records: what differs between one and the next."""

    rate_Hz: float = 1000.0
    noise_m: float = 4e-6
    counts: int = 4096
    lost: float = 0.002
    outliers: float = 0.0
    ramp_s: float = 50.0
    pluck_m: float = 2.5e-3
    phase_step_deg: float = 0.0
    speed_noise_rpm: float = 0.0
    torque_Nm: float = 0.0
    contact_kg_m2: float = 0.0
    light_A: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Recorder:
        """Any laboratory's."""
        return cls(
            float(rng.choice([500, 1000, 2000, 5000])),
            1e-6 * 30 ** rng.random(),
            int(rng.choice([1024, 4096, 16384])),
            0.05 * rng.random() ** 2,
            0.01 * rng.random() ** 2,
            rng.uniform(25, 100),
            rng.uniform(0.5e-3, 3e-3),
        )


@dataclass
class Rig:
    """What is true of one drawn rig, and how it is recorded."""

    rng: np.random.Generator
    folder: Path
    wide: bool = False
    changes: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        draw = self.rng.uniform
        self.recorder = replace(Recorder.drawn(self.rng) if self.wide else Recorder(), **self.changes)
        self.mass_A = PENDULUM_KG * (1 - self.recorder.light_A)
        self.mass = MASS_KG + self.mass_A - PENDULUM_KG
        self.k = np.array([2583.07, 38487.79]) * (1 + 0.1 * draw(-1, 1, 2))
        self.zeta = 0.001 * 200 ** draw(0, 1, 2) if self.wide else 0.02 * 10 ** draw(-0.5, 0.5, 2)
        self.c = 1e-3 * 10 ** (draw(-1, 1, 2) if self.wide else draw(-0.5, 0.5, 2))
        self.imbalance = WEIGHT_KG * 0.02117 * (1 + 0.03 * draw(-1, 1))
        self.beta = np.radians(draw(-20, 20) if self.wide else draw(-5, 5))
        self.gain = 1 + 1e-3 * self.rng.normal(size=2)
        self.zero = np.radians(0.05) * self.rng.normal(size=2)
        dry = self.recorder.torque_Nm, self.recorder.contact_kg_m2
        self.p = np.r_[self.k, 2 * self.zeta * np.sqrt(self.k * self.mass), self.c, self.imbalance, dry, self.mass_A]
        self.number = 0

    @property
    def truth(self) -> dict[str, float]:
        names = ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m"]
        return dict(zip(names, [*self.k, *self.zeta, *self.c, self.imbalance], strict=True))

    def move(self, start, times, motion, free):
        """States at the times with absolute pendulum angles, shape (n, 8); motion: phase, speed and ramp at t = 0."""
        turning = Turning(np.array([[0.0, *motion]]))

        def rotor(at: np.ndarray) -> np.ndarray:
            psi, speed = turning.phase(at)
            none = np.zeros_like(psi)
            return np.stack([none, none, psi, psi, none, none, speed, speed], axis=-1)

        a, b = (
            SwingingMass(mass, LENGTH_M, self.c[i], 0.0, self.recorder.torque_Nm, self.recorder.contact_kg_m2)
            for i, mass in enumerate((self.mass_A, PENDULUM_KG))
        )
        mechanics = Mechanics(self.mass, tuple(self.k), tuple(self.p[2:4]), self.imbalance, a, b)
        times = np.asarray(times, float)
        return moved(mechanics, turning, times, start - rotor(times[:1])[0], free, 1e-4) + rotor(times)

    def write(self, t, state, theta, psi) -> Path:
        turn = np.array([[np.cos(self.beta), np.sin(self.beta)], [-np.sin(self.beta), np.cos(self.beta)]])
        xy = state[:, :2] @ turn.T * self.gain + self.recorder.noise_m * self.rng.normal(size=(len(t), 2))
        xy += 1e-3 * self.rng.normal(size=2)
        spoilt = self.rng.random(xy.shape) < self.recorder.outliers
        xy[spoilt] = self.rng.uniform(-5e-3, 5e-3, int(spoilt.sum()))
        step = 2 * np.pi / self.recorder.counts
        theta = np.round((theta + self.zero) / step + 0.3 * self.rng.normal(size=theta.shape)) * step
        if self.recorder.phase_step_deg:
            phase_step = np.radians(self.recorder.phase_step_deg)
            psi = np.round(psi / phase_step) * phase_step
        rpm = np.gradient(psi, t) * 30 / np.pi + self.recorder.speed_noise_rpm * self.rng.normal(size=len(t))
        rows = np.column_stack([t, xy * 1e3, np.degrees(theta), psi, rpm])
        rows[self.rng.random(len(t)) < self.recorder.lost, 3:5] = np.nan
        self.number += 1
        path = self.folder / f"r{self.number}.csv"
        header = "t_s,x_mm,y_mm,theta3_deg,theta4_deg,psi_rad,speed_rpm"
        np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
        return path

    def ring_down(self, axis: str) -> Path:
        t = np.arange(0, 13.0, 1 / self.recorder.rate_Hz)
        release = 1.5 + 0.01 * self.rng.random()
        held = np.array([self.recorder.pluck_m, 1e-4]) * (1 + 0.1 * self.rng.normal(size=2))
        held = held if axis == "x" else held[::-1]
        state = np.zeros((len(t), 8))
        state[:, :2] = np.clip((t[:, None] - 0.8) / 0.3, 0, 1) * held
        after = t >= release
        lock = self.locks()
        start = np.r_[held, lock, np.zeros(4)]
        # locked pendulums on a resting rotor: two independent oscillators
        for i in range(2):
            w, z = np.sqrt(self.k[i] / self.mass), self.zeta[i]
            wd, s = w * np.sqrt(1 - z * z), t[after] - release
            state[after, i] = held[i] * np.exp(-z * w * s) * (np.cos(wd * s) + z * w / wd * np.sin(wd * s))
        return self.write(t, state, np.tile(start[2:4], (len(t), 1)), np.zeros(len(t)))

    def locks(self):
        return np.radians(np.array([0.0, 180.0]) + self.rng.uniform(-0.2, 0.2, 2))

    def run_up(self) -> Path:
        seconds, top = self.recorder.ramp_s, 15.0 * 2 * np.pi
        t = np.arange(0, seconds, 1 / self.recorder.rate_Hz)
        psi0, lock = self.rng.uniform(-np.pi, np.pi), self.locks()
        motion = (psi0, 0.0, top / seconds)
        state = self.move(np.r_[0, 0, psi0 + lock, np.zeros(4)], t, motion, False)
        psi = psi0 + 0.5 * motion[2] * t * t
        return self.write(t, state, np.tile(lock, (len(t), 1)), psi)

    def spin_down(self) -> Path:
        psi0, lock = self.rng.uniform(-np.pi, np.pi), self.locks()
        t = np.arange(0, 5.0, 1 / self.recorder.rate_Hz)
        flick = 1.0
        speeds = 12 * self.rng.choice([-1, 1], 2) * (1 + 0.1 * self.rng.normal(size=2))
        state = np.tile(np.r_[0, 0, psi0 + lock, np.zeros(4)], (len(t), 1))
        start = np.r_[0, 0, psi0 + lock, 0, 0, speeds]
        after = t >= flick
        state[after] = self.move(start, t[after], (psi0, 0.0, 0.0), True)
        return self.write(t, state, state[:, 2:4] - psi0, np.full(len(t), psi0))

    def point(self) -> tuple[Path, float]:
        """Released at 5.8 times the first natural frequency."""
        w = 5.8 * np.sqrt(2583.07 / MASS_KG)
        psi0, lock, go = self.rng.uniform(-np.pi, np.pi), self.locks(), 6.0 + 0.01 * self.rng.random()
        t = np.arange(0, 16.0, 1 / self.recorder.rate_Hz)
        before = self.steady(w, psi0, lock)
        early = self.move(before, np.r_[t[t < go], go], (psi0, w, 0.0), False)
        later = t[t >= go]
        late = self.move(early[-1], np.r_[go, later], (psi0, w, 0.0), True)[1:]
        state = np.concatenate([early[:-1], late])
        return self.write(t, state, state[:, 2:4] - psi0 - w * t[:, None], psi0 + w * t), go

    def steady(self, w, psi0, lock):
        """The locked rotor's orbit at t = 0."""
        moment = self.imbalance + LENGTH_M * (np.array([self.mass_A, PENDULUM_KG]) * np.exp(1j * lock)).sum()
        a = moment * w * w * np.exp(1j * psi0) / (self.p[:2] - self.mass * w * w + 1j * w * self.p[2:4])
        x, y = a[0], -1j * a[1]
        return np.r_[x.real, y.real, psi0 + lock, (1j * w * x).real, (1j * w * y).real, w, w]

    def record(self, test: str) -> Path:
        """One test recorded and imported; its log."""
        options: dict[str, object] = {}
        if test.startswith("ring-down"):
            path = self.ring_down(test[-1])
        elif test == "run-up":
            path = self.run_up()
        elif test == "spin-down":
            path = self.spin_down()
        else:
            path, go = self.point()
            options["release_s"] = (go,)
        turning = {"phase": "psi_rad:rad"} if test in ("run-up", "point") else {}
        if test == "point" and self.recorder.speed_noise_rpm:  # an encoder for the run-up, a tachometer for the point
            turning = {"speed": "speed_rpm:rpm"}
        recipe = make_recipe(
            test="point-E" if test == "point" else test,
            time="t_s:s",
            x="x_mm:mm",
            y="y_mm:mm",
            theta3="theta3_deg:deg",
            theta4="theta4_deg:deg",
            **turning,
            **options,
        )
        log = path.with_suffix(".mcap")
        import_recording(path, log, self.guess(), recipe)
        return log

    def guess(self):
        """The rig file: wrong where an experimenter's would be."""
        wrong = np.random.default_rng(int(1e6 * self.beta) % 2**31)
        settings = {
            "suspension.k1_N_per_m": self.k[0] * (1 + 0.15 * wrong.uniform(-1, 1)),
            "suspension.k2_N_per_m": self.k[1] * (1 + 0.15 * wrong.uniform(-1, 1)),
            **{f"suspension.zeta{i + 1}": self.zeta[i] * 2 ** wrong.uniform(-1, 1) for i in range(2)},
            **{f"pendulums.{n}.damping_Nms_per_rad": self.c[i] * 2 ** wrong.uniform(-1, 1) for i, n in enumerate("ab")},
        }
        return load_rig("virtual", settings={key: float(value) for key, value in settings.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wide", action="store_true", help="extreme rigs and recorders")
    parser.add_argument("--tests", default=",".join(TESTS))
    parser.add_argument(
        "--change",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="phase_step_deg, speed_noise_rpm, torque_Nm, contact_kg_m2, light_A, rate_Hz …",
    )
    arguments = parser.parse_args()
    changes = {name: float(value) for name, value in (text.split("=") for text in arguments.change)}
    z: dict[str, list[float]] = {}
    relative: dict[str, list[float]] = {}
    seconds = []
    for number in range(arguments.campaigns):
        with tempfile.TemporaryDirectory() as folder:
            rig = Rig(np.random.default_rng([arguments.seed, number]), Path(folder), arguments.wide, changes)
            logs = [rig.record(test) for test in arguments.tests.split(",")]
            began = time.perf_counter()
            try:
                found = identify(load_runs(logs), rig.guess())
            except IdentificationError as error:
                print(f"campaign {number}, {rig.truth}, {rig.recorder}: {error}")
                continue
            seconds.append(time.perf_counter() - began)
        for warning in found.warnings:
            print(f"  campaign {number}: {warning}")
        truth = rig.truth
        each = [("", found.parameters.values, found.parameters.std)]
        far = {n: round((v - truth[n]) / found.parameters.std[n], 1) for n, v in found.parameters.values.items()}
        if max(map(abs, far.values()), default=0.0) > 3.5:
            print(f"  campaign {number}, {truth}, {rig.recorder}: off by {far} standard deviations")
        if missing := set(truth) - set(found.parameters.values):
            print(f"  campaign {number}: without {', '.join(sorted(missing))}; {truth}, {rig.recorder}")
        each += [(f"  {e.test} ", dict(zip(e.names, e.values, strict=True)), e.std) for e in found.estimates]
        for label, values, std in each:
            for name, value in values.items():
                z.setdefault(label + name, []).append((value - truth[name]) / std[name])
                relative.setdefault(label + name, []).append(std[name] / truth[name])
    print(f"{arguments.campaigns} campaigns, seed {arguments.seed}, {np.median(seconds):.2f} s each to identify")
    print(f"{'':36}{'n':>5}{'mean z':>8}{'sd z':>8}{'|z|<1.96':>10}{'max':>7}{'std/value':>11}")
    for name, values in z.items():
        a = np.abs(values)
        share = np.mean(a < 1.96)
        print(
            f"{name:36}{len(a):5}{np.mean(values):8.2f}{np.std(values):8.2f}{share:10.3f}{a.max():7.2f}"
            f"{np.median(relative[name]):11.2e}"
        )
    pooled = np.abs([v for name, values in z.items() if not name.startswith(" ") for v in values])
    print(f"pooled over {len(pooled)} values: within 1.96 {np.mean(pooled < 1.96):.3f}, largest {pooled.max():.2f}")


if __name__ == "__main__":
    main()
