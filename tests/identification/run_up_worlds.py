"""Run-ups of a rotor in worlds that differ from the estimator's model by one small effect once per turn.

The rig is a disk on an anisotropic suspension. Each motion is a forced oscillator from rest, integrated exactly over a
sample with five Gauss points: the disk's two directions, its tilt, and the stand of the lasers. No code of the
estimator is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from daq.signals.run import Run
from identification import RunUpFit, fit_run_up

NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class World:
    """Linear run-up from rest through both resonances.

    Attributes:
        top_Hz, seconds: fastest speed, and duration of the ramp and thus of the record.
        f_Hz, zeta, angle_deg: suspension, and angle from its x axis to sensor x.
        mass_kg, moment_kg_m: rotor.
        noise_m, rate_Hz: of both lasers.
        pendulum_height_m: distance of the locked pendulums in height. Their couple unbalance tilts the disk.
        pendulum_moment_kg_m: first mass moment of each pendulum.
        tilt_Hz, tilt_inertia_kg_m2, lever_m: natural frequency and inertia of the tilt; height of the lasers' targets
            above the disk.
        stand_m_per_N, stand_Hz: static compliance of the lasers' stand by the force of the springs; its frequency.
        floor_m_per_N: the same for the force of the imbalance, which reaches the stand through the drive's bearing.
        lost, lost_at: share of S_P that is lost, and when, as a share of the record.
        slip_deg, slip_at: sudden error of the phase, and when.
        lag_s: lag of both lasers behind the phase.
        bow_m, run_out_m: bent shaft, and run-out of each target.
        curvature: nonlinearity of the lasers at the ends of their range, as a share of the range.
        range_m: half of the range.
    """

    top_Hz: float = 8.0
    seconds: float = 40.0
    f_Hz: tuple[float, float] = (3.0, 5.0)
    zeta: tuple[float, float] = (0.017, 0.017)
    angle_deg: float = 1.5
    mass_kg: float = 7.27
    moment_kg_m: float = 0.12 * 0.02117
    direction_rad: float = 0.0
    noise_m: float = 4e-6
    rate_Hz: float = 500.0
    seed: int = 0
    pendulum_height_m: float = 0.0
    pendulum_moment_kg_m: float = 0.075 * 0.054
    tilt_Hz: float = 20.0
    tilt_inertia_kg_m2: float = 0.02
    lever_m: float = 0.2
    stand_m_per_N: float = 0.0
    floor_m_per_N: float = 0.0
    stand_Hz: float = 15.0
    lost: float = 0.0
    lost_at: float = 0.5
    slip_deg: float = 0.0
    slip_at: float = 0.5
    lag_s: float = 0.0
    bow_m: complex = 0j
    run_out_m: tuple[complex, complex] = (0j, 0j)
    curvature: float = 0.0
    range_m: float = 0.025

    @property
    def eccentricity_m(self) -> float:
        return self.moment_kg_m / self.mass_kg

    @cached_property
    def time_s(self) -> Array:
        return np.arange(round(self.seconds * self.rate_Hz)) / self.rate_Hz

    def turned(self, time_s: Array) -> tuple[Array, Array, float]:
        """Angle, speed and acceleration of the rotor."""
        bend = 2 * np.pi * self.top_Hz / self.seconds
        return 0.5 * bend * time_s**2, bend * time_s, bend

    @cached_property
    def nodes_s(self) -> Array:
        """Gauss points of each sample's step, shape (n − 1, 5)."""
        return self.time_s[:-1, None] + 0.5 / self.rate_Hz * (NODES + 1)

    @cached_property
    def drive(self) -> Complex:
        """Unit imbalance's acceleration at the Gauss points."""
        psi, speed, bend = self.turned(self.nodes_s)
        return (speed**2 - 1j * bend) * np.exp(1j * psi)

    def response(self, force: Complex, f_Hz: float, zeta: float) -> Complex:
        """q of q̈ + 2ζω q̇ + ω² q = force, from rest, at the samples."""
        step = 1 / self.rate_Hz
        lam = 2 * np.pi * f_Hz * complex(-zeta, np.sqrt(1 - zeta**2))
        parts: list[Complex] = []
        for one in (lam, np.conj(lam)):
            push = force @ (0.5 * step * WEIGHTS * np.exp(one * 0.5 * step * (1 - NODES)))
            parts.append(lfilter([1.0], [1.0, -np.exp(one * step)], np.r_[0.0, push]))
        return (parts[0] - parts[1]) / (lam - np.conj(lam))

    def _disk(self) -> tuple[Array, Array]:
        """Motion of the disk's centre along the stiffness axes."""
        left = 1 - self.lost * (self.nodes_s > self.lost_at * self.seconds)
        force = self.eccentricity_m * np.exp(1j * self.direction_rad) * left * self.drive
        turn = np.exp(1j * self.turned(self.nodes_s)[0])
        q: list[Complex] = []
        for f, zeta in zip(self.f_Hz, self.zeta, strict=True):
            # the rotor rests on its springs at the bow's first position
            pull = (2 * np.pi * f) ** 2 * self.bow_m * (turn - 1)
            q.append(self.bow_m + self.response(force + pull, f, zeta))
        return q[0].real, q[1].imag

    def _shown(self) -> tuple[Array, Array]:
        """Displacements between targets and lasers along the stiffness axes."""
        x, y = self._disk()
        couple = self.pendulum_height_m * self.pendulum_moment_kg_m / self.tilt_inertia_kg_m2
        tilt = self.response(couple * np.exp(0.6j) * self.drive, self.tilt_Hz, 0.01) if couple else 0j * self.time_s
        stiffness = [self.mass_kg * (2 * np.pi * f) ** 2 for f in self.f_Hz]
        stand: list[Array] = []
        for q, k in zip((x, y), stiffness, strict=True):
            carried = self.stand_m_per_N * k * make_interp_spline(self.time_s, q, 5)(self.nodes_s)
            stand.append(self._stand(carried.astype(complex)).real if self.stand_m_per_N else 0 * q)
        force = self.floor_m_per_N * self.moment_kg_m * self.drive
        floor = self._stand(force) if self.floor_m_per_N else 0j * self.time_s
        return (
            x + self.lever_m * tilt.real - stand[0] - floor.real,
            y + self.lever_m * tilt.imag - stand[1] - floor.imag,
        )

    def _stand(self, static: Complex) -> Complex:
        omega = 2 * np.pi * self.stand_Hz
        return self.response(omega**2 * static, self.stand_Hz, 0.02)

    @cached_property
    def signal_m(self) -> Array:
        x, y = self._shown()
        c, s = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        seen = np.column_stack([c * x + s * y, c * y - s * x])
        turn = np.exp(1j * self.turned(self.time_s)[0])
        seen += np.column_stack([(self.run_out_m[0] * turn).real, (self.run_out_m[1] * turn).imag])
        share = seen / self.range_m
        seen += self.curvature * self.range_m * share**2 * (1 + share)
        if self.lag_s:
            seen = make_interp_spline(self.time_s, seen, 5)(np.maximum(self.time_s - self.lag_s, 0.0))
        noise = np.random.default_rng(self.seed).normal(size=seen.shape)
        return seen + np.array([1e-3, -5e-4]) + self.noise_m * noise

    @cached_property
    def phase_rad(self) -> Array:
        slipped = self.time_s > self.slip_at * self.seconds
        return self.turned(self.time_s)[0] + np.radians(self.slip_deg) * slipped

    def run(self, locked_rad: tuple[float, float] = (0.0, np.pi)) -> Run:
        """The record with the angles that the encoders show of the locked pendulums."""
        return Run(
            "run-up",
            "run-up.mcap",
            0.0,
            x_time_s=self.time_s,
            x_m=self.signal_m[:, 0],
            y_time_s=self.time_s,
            y_m=self.signal_m[:, 1],
            phase_time_s=self.time_s,
            phase_rad=self.phase_rad,
            angle_time_s=self.time_s,
            mark_time_s=np.empty(0),
            mark_phase_rad=np.empty(0),
            angle_rad=np.tile(np.array(locked_rad), (len(self.time_s), 1)),
        )

    def fit(self, **options: object) -> RunUpFit:
        return fit_run_up(self.time_s, self.signal_m, self.phase_rad, **options)  # type: ignore[arg-type]
