"""Recorded runs made up from the dynamics: every imperfection of the sensors, no bytes.

One `Campaign` is one rig with its drawn gains, encoder zeros and truth; its methods record one test each.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from daq.signals.run import Release, Run
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import integrate, locked_state
from rig_configs.load import load_rig
from rig_configs.schema import Rig

STEP = 2 * np.pi / 4096
LASER_LSB = 0.025 / 64000


@dataclass
class Campaign:
    """One rig with drawn calibration; every recording draws its own clocks, noise and losses."""

    seed: int = 0
    settings: dict[str, Any] = field(default_factory=dict)
    rig_name: str = "virtual"
    axis_angle_deg: float = 1.0
    laser_noise_m: float = 4e-6
    clock_rate_std: float = 3e-6
    delay_std_s: float = 2e-3
    calibrated: bool = False

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.rig: Rig = load_rig(self.rig_name, settings=self.settings)
        self.truth: RotorParameters = self.rig.true_physics
        share = 0.0 if self.calibrated else 1.0
        self.gain = 1 + share * self.rig.devices["laser_x"].gain_std * self.rng.normal(size=2)
        zero = np.radians(self.rig.devices["encoder"].zero_std_deg)
        self.zero = share * zero * self.rng.normal(size=2)

    def _clock(self) -> tuple[float, float]:
        return self.clock_rate_std * self.rng.normal(), self.delay_std_s * self.rng.normal()

    def _stamped(self, true_s: np.ndarray, clock: tuple[float, float]) -> np.ndarray:
        return true_s * (1 + clock[0]) + clock[1]

    def lasers(self, time: np.ndarray, state: np.ndarray) -> dict[str, np.ndarray]:
        """Both sensors' samples of a motion; state (n, 4): x, y and their rates."""
        b = np.radians(self.axis_angle_deg)
        mix = np.array([[np.cos(b), np.sin(b)], [-np.sin(b), np.cos(b)]]) * self.gain[:, None]
        motion = CubicHermiteSpline(time, state[:, :2] @ mix.T, state[:, 2:] @ mix.T)
        out = {}
        for i, axis in enumerate("xy"):
            t = np.arange(time[0] + self.rng.uniform(0, 2.5e-4), time[-1], 1 / 4000)
            signal = motion(t)[:, i] + self.laser_noise_m * self.rng.normal(size=len(t))
            signal += 1e-3 * self.rng.normal()
            keep = ~_bursts(self.rng, len(t), 2e-5, 0.02)
            signal[self.rng.random(len(t)) < 1e-4] = np.nan
            out[f"{axis}_time_s"] = self._stamped(t, self._clock())[keep]
            out[f"{axis}_m"] = (np.round(signal / LASER_LSB) * LASER_LSB)[keep]
        return out

    def encoder(
        self, time: np.ndarray, angle: np.ndarray, rate: np.ndarray, marks: np.ndarray, phase: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Angles, marks and the map from true to stamped time of the node."""
        clock = self._clock()
        t = np.arange(time[0] + 1e-4, time[-1], 1e-3)
        true = CubicHermiteSpline(time, angle, rate)(t) + self.zero
        counts = np.round(true / STEP + 0.3 * self.rng.normal(size=true.shape))
        keep = ~_bursts(self.rng, len(t), 0.002 / 10, 0.05)
        there = ~_bursts(self.rng, len(marks), 0.01, 0.5)
        stamps = np.round(self._stamped(marks, clock) * 1e6) / 1e6
        self._encoder_clock = clock
        return {
            "angle_time_s": self._stamped(t, clock)[keep],
            "angle_rad": counts[keep] * STEP,
            "mark_time_s": stamps[there],
            "mark_phase_rad": phase[there],
        }

    def _run(self, test: str, releases: tuple[Release, ...] = (), **signals: Any) -> Run:
        rates = dict.fromkeys(("x", "y", "angles", "phase"), self.clock_rate_std)
        return Run(test, f"{test}-{self.seed}.mcap", 0.0, releases=releases, clock_rate_std=rates, **signals)

    def ring_down(self, axis: str, held_m: float = 2.5e-3, record_s: float = 12.0) -> Run:
        """One second of quiet, half a second held, then free."""
        p = self.truth
        main = held_m * (1 + 0.1 * self.rng.normal())
        side = main * 0.05 * self.rng.normal()
        held = np.array([main, side] if axis == "x" else [side, main])
        release = 1.6 + 0.05 * self.rng.normal()
        time = np.arange(0, record_s + release, 1e-3)
        state = np.zeros((len(time), 4))
        pull = np.clip((time - 1.0) / 0.2, 0, 1)
        state[:, :2] = (3 * pull**2 - 2 * pull**3)[:, None] * held
        state[:, 2:] = (6 * pull - 6 * pull**2)[:, None] * held / 0.2
        free = time >= release
        for i, (w, z) in enumerate(zip(p.natural_frequencies_rad_s, (p.zeta1, p.zeta2), strict=True)):
            wave = w * np.sqrt(1 - z * z)
            rate = complex(-z * w, wave)
            a = held[i] * (1 - 1j * z * w / wave)
            decay = a * np.exp(rate * (time[free] - release))
            state[free, i], state[free, 2 + i] = decay.real, (rate * decay).real
        locked = np.tile([0.001, np.pi - 0.002], (len(time), 1))
        none = np.empty(0)
        return self._run(
            f"ring-down-{axis}",
            **self.lasers(time, state),
            **self.encoder(time, locked, 0 * locked, none, none),
        )

    def run_up(self, to_rpm: float = 900.0, ramp_s: float = 40.0) -> Run:
        """From rest through both resonances, pendulums locked."""
        end = ramp_s + 2.0
        time = np.arange(0, end, 1e-3)
        top = to_rpm * np.pi / 30 * 0.998
        dense = np.arange(0, end + 0.01, 1e-3)
        wanted = np.clip((dense - 1.0) / ramp_s, 0, 1) * top
        lag = 0.08
        speed = np.empty_like(wanted)
        speed[0] = 0.0
        keep = np.exp(-1e-3 / lag)
        for i in range(1, len(dense)):
            speed[i] = keep * speed[i - 1] + (1 - keep) * wanted[i - 1]
        psi0 = self.rng.uniform(-np.pi, np.pi)
        psi = psi0 + CubicSpline(dense, speed).antiderivative()(dense)
        history = SpeedHistory.from_phases(dense, psi)
        lock = self._locks()
        start = np.zeros(8)
        start[2:4] = lock
        states = integrate(start, time, 1e-3, history.knots_s, history.coefficients, self.truth.packed(), 0.0, 0.0)
        first = np.ceil(psi0 / (2 * np.pi))
        turns = 2 * np.pi * np.arange(first, np.floor(psi[len(time) - 1] / (2 * np.pi)) + 1)
        moving = np.flatnonzero(np.diff(psi) > 1e-9)
        marks = np.interp(turns, psi[moving], dense[moving])
        for _ in range(3):
            ph = history.phase(marks)
            marks = marks - (ph[:, 0] - turns) / np.maximum(ph[:, 1], 1e-3)
        locked = np.tile(lock, (len(time), 1))
        return self._run(
            "run-up",
            **self.lasers(time, states[:, [0, 1, 4, 5]]),
            **self.encoder(time, locked, 0 * locked, marks, turns),
        )

    def _locks(self) -> np.ndarray:
        return np.radians(np.array([0.0, 180.0]) + self.rng.uniform(-0.2, 0.2, 2))

    def spin_down(self, record_s: float = 4.0, apart_s: float = 0.3) -> Run:
        """Rotor at rest, both pendulums flicked."""
        psi = self.rng.uniform(0, 2 * np.pi)
        history = SpeedHistory.constant(0.0, psi)
        speeds = self.rng.choice([-1, 1], 2) * 10 * (1 + 0.1 * self.rng.normal(size=2))
        flicks = np.sort(1.0 + self.rng.uniform(0, apart_s, 2))
        first = int(self.rng.integers(2))
        time = np.arange(0, record_s + 1.5, 1e-3)
        start = np.zeros(8)
        start[2:4] = self._locks()
        cuts = [0.0, *flicks, time[-1] + 1e-3]
        states, kick = [], [None, first, 1 - first]
        for i, pendulum in enumerate(kick):
            if pendulum is not None:
                start[6 + pendulum] += speeds[pendulum]
            inside = time[(time >= cuts[i]) & (time < cuts[i + 1])]
            span = np.r_[cuts[i], inside, cuts[i + 1]]
            out = integrate(start, span, 1e-3, history.knots_s, history.coefficients, self.truth.packed(), 1.0, 1.0)
            states.append(out[1:-1])
            start = out[-1].copy()
        state = np.concatenate(states)
        none = np.empty(0)
        return self._run(
            "spin-down",
            **self.lasers(time, state[:, [0, 1, 4, 5]]),
            **self.encoder(time, state[:, 2:4], state[:, 6:8], none, none),
        )

    def point(self, name: str, record_s: float = 8.0) -> Run:
        """Locked for three seconds, then both pendulums released."""
        speed = self.rig.physics.speed_rad_s(self.rig.points[name].speed_ratio) * 0.998
        psi0 = self.rng.uniform(-np.pi, np.pi)
        history = SpeedHistory.constant(speed, psi0)
        lock, go = self._locks(), 3.2 + self.rng.uniform(0, 0.1)
        time = np.arange(0, record_s + go, 1e-3)
        before, after = time[time < go], time[time >= go]
        packed, knots, coefficients = self.truth.packed(), history.knots_s, history.coefficients
        start = locked_state(self.truth, speed, psi0, *lock)
        early = integrate(start, np.r_[before, go], 5e-4, knots, coefficients, packed, 0.0, 0.0)
        late = integrate(early[-1], np.r_[go, after], 5e-4, knots, coefficients, packed, 1.0, 1.0)
        state = np.concatenate([early[:-1], late[1:]])
        turns = 2 * np.pi * np.arange(np.ceil(psi0 / 2 / np.pi), np.floor((psi0 + speed * time[-1]) / 2 / np.pi))
        signals = self.encoder(time, state[:, 2:4], state[:, 6:8], (turns - psi0) / speed, turns)
        stamp = float(self._stamped(np.array(go), self._encoder_clock)) + 5e-4 * self.rng.normal()
        releases = (Release(0, stamp), Release(1, stamp))
        return self._run(f"point-{name}", releases, **self.lasers(time, state[:, [0, 1, 4, 5]]), **signals)

    def commissioning(self) -> list[Run]:
        """The four tests before the validation points."""
        return [self.ring_down("x"), self.ring_down("y"), self.spin_down(), self.run_up()]


def _bursts(rng: np.random.Generator, n: int, start: float, stop: float) -> np.ndarray:
    """A two-state loss model: True where a sample is lost."""
    lost = np.zeros(n, bool)
    at = int(rng.geometric(start)) if n else 0
    while at < n:
        length = int(rng.geometric(stop))
        lost[at : at + length] = True
        at += length + int(rng.geometric(start))
    return lost
