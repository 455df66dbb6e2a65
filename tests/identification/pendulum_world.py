"""Pendulum tests of a rig that is simulated for these tests alone: equations of motion by scipy, read by two encoders.

M q̈ + (c1 ẋ + k1 x) + i (c2 ẏ + k2 y) = Σ S_i (φ̇_i² − i φ̈_i) e^{iφ_i} + S_P ω² e^{iψ},  φ_i = ψ + θ_i, ψ̇ = ω,
J_i θ̈_i = S_i (ẍ sin φ_i − ÿ cos φ_i) − c_i θ̇_i    for each free pendulum, θ̈_i = 0 for a locked one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import solve_ivp

from daq.signals.run import Release, Run
from dynamics.equations.parameters import RotorParameters
from identification.pendulums.suspension_knowledge import Knowledge
from rig_configs import load_rig

RATE_Hz, COUNTS = 1000.0, 4096
MESSAGE_S = 3.0
"""Instant of the message that the locks are open, s."""
SUSPENSION = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")


@dataclass(frozen=True)
class Encoders:
    """Readings of both pendulums.

    Attributes:
        off_axis_rad: amplitude of the error of a scale that is mounted off its axis, once per turn of its pendulum.
        off_axis_at_rad: angle of each pendulum at which that error is 0.
        jitter: noise before the rounding, in steps.
    """

    off_axis_rad: tuple[float, float] = (0.0, 0.0)
    off_axis_at_rad: tuple[float, float] = (0.4, 2.1)
    jitter: float = 0.3

    def read(self, angle_rad: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        step = 2 * math.pi / COUNTS
        shown = angle_rad + np.array(self.off_axis_rad) * np.sin(angle_rad - np.array(self.off_axis_at_rad))
        return np.round(shown / step + self.jitter * rng.standard_normal(shown.shape)) * step


@dataclass(frozen=True)
class World:
    """A rig and its encoders.

    Attributes:
        physics: true numbers.
        encoders: readings of both pendulums.
    """

    physics: RotorParameters = field(default_factory=lambda: load_rig("virtual").physics)
    encoders: Encoders = Encoders()

    def release(
        self,
        speed_ratio: float,
        seed: int = 0,
        late_s: tuple[float, float] = (0.0, 0.0),
        record_s: float = 6.0,
    ) -> Run:
        """Return a release at constant speed.

        Args:
            speed_ratio: speed over the first natural frequency.
            seed: seed of phase, play of the locks and noise.
            late_s: instant at which the lock of A and of B opens, minus that of its message, s.
            record_s: length after the message, s.
        """
        rng, p = np.random.default_rng([seed, 1]), self.physics
        speed, psi0 = p.speed_rad_s(speed_ratio), float(rng.uniform(-math.pi, math.pi))
        lock = np.array([0.0, math.pi]) + np.radians(rng.uniform(-0.2, 0.2, 2))
        time = np.arange(0.0, MESSAGE_S + record_s, 1 / RATE_Hz)
        opens = MESSAGE_S + np.array(late_s)
        first, last = float(np.min(opens)), float(np.max(opens))
        orbit = self._locked_orbit(speed, lock)

        def locked(t: np.ndarray) -> np.ndarray:
            turn = np.exp(1j * (psi0 + speed * t))
            x, y = orbit[0] * turn, orbit[1] * turn
            still = np.zeros(len(t))
            rates = [(1j * speed * x).real, (1j * speed * y).real, still, still]
            return np.array([x.real, y.real, still + lock[0], still + lock[1], *rates])

        parts = [locked(time[time < first])]
        state = locked(np.array([first]))[:, 0]
        if last > first:
            between = time[(time >= first) & (time < last)]
            moved, state = self._moved(state, first, last, between, speed, psi0, opens <= first)
            parts.append(moved)
        parts.append(self._moved(state, last, float(time[-1]), time[time >= last], speed, psi0, opens <= last)[0])
        states = np.hstack(parts)
        turns = 2 * math.pi * np.arange(math.ceil(psi0 / 2 / math.pi), (psi0 + speed * time[-1]) // (2 * math.pi))
        marks = ((turns - psi0) / speed, turns)
        return self._run("point-D", time, states, rng, marks, (Release(0, MESSAGE_S), Release(1, MESSAGE_S)))

    def spin_down(self, seed: int = 0, speed_rad_s: tuple[float, float] = (11.0, -10.0), record_s: float = 6.0) -> Run:
        """Return a spin-down on a resting rotor: both pendulums at rest, then flicked together after half a second."""
        rng = np.random.default_rng([seed, 2])
        psi0, flick = float(rng.uniform(0, 2 * math.pi)), 0.5
        lock = np.array([0.0, math.pi]) + np.radians(rng.uniform(-0.2, 0.2, 2))
        speed = np.array(speed_rad_s) * (1 + 0.05 * rng.standard_normal(2))
        time = np.arange(0.0, flick + record_s, 1 / RATE_Hz)
        before = np.tile(np.r_[0.0, 0.0, lock, np.zeros(4)][:, None], np.count_nonzero(time < flick))
        start = np.r_[0.0, 0.0, lock, 0.0, 0.0, speed]
        after = self._moved(start, flick, float(time[-1]), time[time >= flick], 0.0, psi0, np.array([True, True]))[0]
        none = np.empty(0)
        return self._run("spin-down", time, np.hstack([before, after]), rng, (none, none), ())

    @property
    def knowledge(self) -> Knowledge:
        """Suspension and S_P known to 0.1 %; masses and lengths known exactly."""
        true = self.physics.identified()
        found = {name: true[name] for name in SUSPENSION}
        return Knowledge.nominal(self.physics).with_found(found, {name: 1e-3 * value for name, value in found.items()})

    def _locked_orbit(self, speed: float, lock: np.ndarray) -> tuple[complex, complex]:
        p = self.physics
        moments = np.array([p.a.first_moment_kg_m, p.b.first_moment_kg_m]) * np.exp(1j * lock)
        force = (p.imbalance_moment_kg_m + moments.sum()) * speed**2
        c1, c2 = p.damping_Ns_per_m
        x = force / (p.k1_N_per_m - p.total_mass_kg * speed**2 + 1j * speed * c1)
        y = -1j * force / (p.k2_N_per_m - p.total_mass_kg * speed**2 + 1j * speed * c2)  # the imaginary part of force
        return complex(x), complex(y)

    def _moved(
        self,
        start: np.ndarray,
        begin_s: float,
        end_s: float,
        time_s: np.ndarray,
        speed: float,
        psi0: float,
        free: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the states at the instants, shape (8, n), and at the end, shape (8,)."""
        p = self.physics
        pendulums = [(q.first_moment_kg_m, q.inertia_kg_m2, q.damping_Nms_per_rad) for q in (p.a, p.b)]
        c1, c2 = p.damping_Ns_per_m
        whole, imbalance, k1, k2 = p.total_mass_kg, p.imbalance_moment_kg_m, p.k1_N_per_m, p.k2_N_per_m

        def rates(t: float, s: Sequence[float]) -> list[float]:
            psi = psi0 + speed * t
            fx = imbalance * speed**2 * math.cos(psi) - c1 * s[4] - k1 * s[0]
            fy = imbalance * speed**2 * math.sin(psi) - c2 * s[5] - k2 * s[1]
            mxx, mxy, myy = whole, 0.0, whole
            for i, (moment, inertia, damping) in enumerate(pendulums):
                sine, cosine, rate = math.sin(psi + s[2 + i]), math.cos(psi + s[2 + i]), s[6 + i]
                pull = moment * (speed + rate) ** 2
                fx, fy = fx + pull * cosine, fy + pull * sine
                if free[i]:  # θ̈ = (S (ẍ sin φ − ÿ cos φ) − c θ̇)/J acts on the disk with −i S θ̈ e^{iφ}
                    own, share = -damping * rate / inertia, moment * moment / inertia
                    fx, fy = fx + moment * own * sine, fy - moment * own * cosine
                    mxx, myy = mxx - share * sine * sine, myy - share * cosine * cosine
                    mxy += share * sine * cosine
            size = mxx * myy - mxy * mxy
            ax, ay = (myy * fx - mxy * fy) / size, (mxx * fy - mxy * fx) / size
            out = [s[4], s[5], s[6], s[7], ax, ay]
            for i, (moment, inertia, damping) in enumerate(pendulums):
                across = ax * math.sin(psi + s[2 + i]) - ay * math.cos(psi + s[2 + i])
                out.append((moment * across - damping * s[6 + i]) / inertia if free[i] else 0.0)
            return out

        wanted = np.r_[time_s, end_s] if not len(time_s) or time_s[-1] < end_s else time_s
        found = solve_ivp(rates, (begin_s, end_s), start, "DOP853", wanted, rtol=1e-9, atol=1e-12)
        assert found.success, found.message
        return found.y[:, : len(time_s)], found.y[:, -1]

    def _run(
        self,
        test: str,
        time: np.ndarray,
        states: np.ndarray,
        rng: np.random.Generator,
        marks: tuple[np.ndarray, np.ndarray],
        releases: tuple[Release, ...],
    ) -> Run:
        angle = self.encoders.read(states[2:4].T, rng)
        lasers = states[:2] + 4e-6 * rng.standard_normal((2, len(time)))
        clocks = dict.fromkeys(("x", "y", "angles", "phase"), 0.0)
        step = 2 * math.pi / COUNTS
        return Run(
            test, f"{test}.mcap", 0.0, time, lasers[0], time, lasers[1], time, angle, *marks, releases, step, clocks
        )


def with_loose_lock(run: Run, pendulum: int, moved_deg: float, at_s: float) -> Run:
    """Return a run in which a pendulum moves in its closed lock: it stays at another angle from an instant on."""
    angle = run.angle_rad.copy()
    angle[run.angle_time_s > at_s, pendulum] += math.radians(moved_deg)
    return replace(run, angle_rad=angle)
