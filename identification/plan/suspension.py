"""Models of ring-down and run-up for planning: two linear modes in two turned, offset, delayed sensors.

The code is independent of the estimators: signals at instants, no block averages, derivatives by differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from identification.estimate import Estimate
from identification.plan.experiment import Experiment
from identification.plan.information import covariance, derivatives
from identification.plan.sensors import SensorProperties
from identification.typed_scipy import lfilter
from rig_basics.arrays import Array, Complex
from rig_basics.units import TO_RPM
from rig_configs.error_label import ErrorLabel

_PER_CYCLE = 8  # number of evaluated instants per cycle of the fastest mode
_SIDE = 0.05  # share of a pluck along one axis that displaces the other axis
_AXIS_STD = float(np.radians(3.0))  # standard uncertainty of the angle between sensors and stiffness axes, rad
_DELAY_STD_S, _RUN_UP_DELAY_STD_S = 3e-3, 10e-3  # standard uncertainties of delays between the devices' clocks
_FOUR = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")


def ring_down(
    physics: RotorParameters, sensors: SensorProperties, axis: str, held_m: float, record_s: float, test: str = ""
) -> Experiment:
    """Return a ring-down: a pluck along x or y and the free decay after it. Only that direction is estimated.

    Args:
        physics: nominal parameters.
        sensors: sensor properties.
        axis: "x" or "y", an axis with a sensor.
        held_m: displacement of the disk before the release, m.
        record_s: length after the release, s.
        test: name of the test; "" for that of the axis.
    """
    main = 0 if axis == "x" else 1
    held = np.where(np.arange(2) == main, 1.0, _SIDE) * held_m
    omegas = np.array(physics.natural_frequencies_rad_s)
    zetas = np.array([physics.zeta1, physics.zeta2])
    t = _instants(record_s, omegas.max())
    # θ = ln ω, ln ζ of both, axis angle, ln gain ratio, delay of y, cos and sin amplitude of both
    waves = omegas * np.sqrt(1 - zetas**2)
    theta = np.r_[np.log(omegas), np.log(zetas), 0.0, 0.0, 0.0, held, held * zetas * omegas / waves]

    def signal(at: Array) -> Array:
        turn, ratio, delay = at[4], np.exp(at[5]), at[6]
        w, z = np.exp(at[:2]), np.exp(at[2:4])

        def motion(time: Array) -> Array:
            angle = np.outer(w * np.sqrt(1 - z * z), time)
            return np.exp(-np.outer(z * w, time)) * (at[7:9, None] * np.cos(angle) + at[9:11, None] * np.sin(angle))

        x, y = motion(t), motion(t - delay)
        return np.r_[np.cos(turn) * x[0] + np.sin(turn) * x[1], ratio * (np.cos(turn) * y[1] - np.sin(turn) * y[0])]

    step = np.r_[np.full(4, 1e-5), 1e-5, 1e-5, 1e-6, np.full(4, 1e-6 * held_m)]
    zero = np.zeros_like(t)
    drift = np.column_stack(
        [np.r_[np.ones_like(t), zero], np.r_[t, zero], np.r_[zero, np.ones_like(t)], np.r_[zero, t]]
    )
    jacobian = np.column_stack([derivatives(signal, theta, step), drift]) * _weight(sensors, t, record_s)[:, None]
    prior = np.full(jacobian.shape[1], np.inf)
    prior[4:7] = _AXIS_STD, float(np.hypot(*sensors.gain_std)), _DELAY_STD_S
    own = covariance(jacobian, prior, 4)
    clock = 2 * sensors.clock_rate_std(axis, record_s)  # k is proportional to the square of the clock's rate
    names, own = (_FOUR[main], _FOUR[2 + main]), own[main::2, main::2]
    shared = sensors.clock_error(axis, np.array([clock, 0.0]))
    settings = {"pluck_mm": 1e3 * held_m, "record_s": record_s}
    test = test or f"ring-down-{axis}"
    expected = _estimate(physics, test, names, own, shared)
    return Experiment(test, "ring-down", settings, record_s, expected, held_m, _close_pair(physics))


def run_up(
    physics: RotorParameters, sensors: SensorProperties, top_rad_s: float, ramp_s: float, test: str = "run-up"
) -> Experiment:
    """Return a run-up: a ramp of constant rate from rest through both resonances with locked pendulums.

    Args:
        physics: nominal parameters.
        sensors: sensor properties.
        top_rad_s: speed at the end of the ramp, rad/s.
        ramp_s: duration of the ramp, s.
        test: name of the test.
    """
    model = _RunUp.of(physics, sensors, top_rad_s, ramp_s)
    jacobian, prior = model.jacobian()
    bound = covariance(jacobian, prior, 6)
    gains = np.array(sensors.gain_std)
    # the imbalance is the mean of both amplitudes, weighted by their noise and gain errors together
    weights = np.linalg.solve(bound[4:, 4:] + np.diag(gains**2), np.ones(2))
    weights /= weights.sum()
    forced = physics.forcing_moment_kg_m + physics.a.first_moment_kg_m - physics.b.first_moment_kg_m
    slope = forced / physics.imbalance_moment_kg_m
    reduce = np.zeros((5, 6))
    reduce[[0, 1], [0, 1]] = 1
    reduce[[2, 3], [2, 3]] = 1
    reduce[4, 4:] = slope * weights
    clock = 2 * sensors.clock_rate_std("phase", ramp_s)
    shared = sensors.clock_error("phase", np.array([clock, clock, 0, 0, 0]))
    for i, axis in enumerate("xy"):
        shared[ErrorLabel("gain", axis)] = np.array([0, 0, 0, 0, slope * weights[i] * gains[i]])
    own = reduce @ bound @ reduce.T
    names = (*_FOUR, "SP_kg_m")
    settings = {"top_rpm": top_rad_s * TO_RPM, "ramp_s": ramp_s, "rate_rpm_per_s": top_rad_s * TO_RPM / ramp_s}
    expected = _estimate(physics, test, names, own, shared)
    return Experiment(test, "passage", settings, ramp_s, expected, model.largest_m, _close_pair(physics))


def _estimate(
    physics: RotorParameters,
    test: str,
    names: tuple[str, ...],
    log_covariance: Array,
    shared: dict[ErrorLabel, Array],
) -> Estimate:
    """Return an estimate in the parameters' units from the covariance of ln ω, ln ω, ln ζ, …; k grows with ω²."""
    values = np.array([physics.identified()[n] for n in names])
    grow = np.array([2.0 if n.startswith("k") else 1.0 for n in names])
    shared = {label: shift * values for label, shift in shared.items()}
    return Estimate(
        test,
        ("planned",),
        names,
        values,
        log_covariance * np.outer(grow * values, grow * values),
        shared,
        "Fisher information",
    )


def _instants(record_s: float, fastest_rad_s: float) -> Array:
    n = int(np.ceil(record_s * fastest_rad_s / (2 * np.pi) * _PER_CYCLE)) + 1
    return (np.arange(n) + 0.5) * record_s / n


def _weight(sensors: SensorProperties, t: NDArray[np.floating], record_s: float) -> Array:
    """Return 1/σ of each instant, which represents all samples up to the next one."""
    per = record_s / len(t)
    return np.concatenate(
        [
            np.full(len(t), np.sqrt(rate * per) / noise)
            for rate, noise in zip(sensors.laser_rate_Hz, sensors.laser_noise_m, strict=True)
        ]
    )


def _close_pair(physics: RotorParameters) -> tuple[str, ...]:
    f1, f2 = (w / (2 * np.pi) for w in physics.natural_frequencies_rad_s)
    half = max(f1 * physics.zeta1, f2 * physics.zeta2)
    if abs(f2 - f1) < 0.2 * half:
        return (f"{f1:.4g} and {f2:.4g} Hz differ by less than a tenth of their bandwidth: axes may not be resolved",)
    return ()


@dataclass(frozen=True)
class _RunUp:
    """Forced response of a run-up on a grid.

    Attributes:
        physics: nominal parameters.
        sensors: sensor properties.
        ramp_s: duration of the ramp, s.
        step_s: step of the grid, s.
        force: (ψ̇² − iψ̈) e^{iψ} on the grid, shape (n,).
        every: number of grid steps between the evaluated instants.
    """

    physics: RotorParameters
    sensors: SensorProperties
    ramp_s: float
    step_s: float
    force: Complex
    every: int

    @classmethod
    def of(cls, physics: RotorParameters, sensors: SensorProperties, top_rad_s: float, ramp_s: float) -> _RunUp:
        step = 2 * np.pi / top_rad_s / 32  # the linear interpolation between instants has an error of 3e-3 of the force
        t = np.arange(int(ramp_s / step)) * step
        rate = top_rad_s / ramp_s
        force = cast("Complex", ((rate * t) ** 2 - 1j * rate) * np.exp(0.5j * rate * t**2))
        fastest = max(top_rad_s, *physics.natural_frequencies_rad_s)
        return cls(physics, sensors, ramp_s, step, force, max(1, int(2 * np.pi / fastest / _PER_CYCLE / step)))

    def response(self, omega: float, zeta: float) -> Complex:
        """Return h on the grid for ḧ + 2ζω ḣ + ω² h = u from rest, exact for u that is linear between the instants."""
        root: complex = np.sqrt(complex(zeta * zeta - 1))
        out: Complex = np.zeros(len(self.force), np.complex128)
        for sign in (1, -1):
            pole = omega * (-zeta + sign * root)
            z = pole * self.step_s
            grow = np.exp(z)
            first = (grow - 1 - z) / z**2 * self.step_s  # weight of the later instant
            last = (grow - 1) / z * self.step_s - first
            filtered = lfilter([first, last], [1, -grow], self.force)
            out += sign * filtered / (2 * omega * root)
        return out

    @property
    def largest_m(self) -> float:
        """Largest displacement along x or y, m."""
        p = self.physics
        pairs = zip(p.natural_frequencies_rad_s, (p.zeta1, p.zeta2), strict=True)
        forced = abs(p.forcing_moment_kg_m + p.a.first_moment_kg_m - p.b.first_moment_kg_m)
        return forced / p.total_mass_kg * max(float(np.abs(self.response(w, z)).max()) for w, z in pairs)

    def jacobian(self) -> tuple[Array, Array]:
        """Return the derivatives of the samples over their standard deviation, and the prior standard deviations.

        The parameters are ln ω, ln ζ and ln amplitude, each of both modes, then the nuisance parameters.

        Returns:
            Derivatives, shape (2 n, 25), and prior standard deviations, shape (25,), inf for no information.
        """
        p, cut = self.physics, slice(None, None, self.every)
        t = np.arange(len(self.force))[cut] * self.step_s
        eccentric = (p.forcing_moment_kg_m + p.a.first_moment_kg_m - p.b.first_moment_kg_m) / p.total_mass_kg
        h, by_omega, by_zeta, rate = list[Complex](), list[Complex](), list[Complex](), list[Complex]()
        for w, z in zip(p.natural_frequencies_rad_s, (p.zeta1, p.zeta2), strict=True):
            h.append(self.response(w, z))
            by_omega.append((self.response(w * (1 + 1e-5), z) - self.response(w * (1 - 1e-5), z)) / 2e-5)
            by_zeta.append((self.response(w, z * (1 + 1e-4)) - self.response(w, z * (1 - 1e-4))) / 2e-4)
            rate.append(np.gradient(h[-1], self.step_s))

        def part_of(sensor: int, value: Complex) -> Array:  # x of the first, y of the second oscillator
            return value.imag if sensor else value.real

        n, count = len(t), 25
        out = np.zeros((2 * n, count))
        weight = _weight(self.sensors, t, self.ramp_s)
        for s in range(2):
            rows, o = slice(s * n, (s + 1) * n), 1 - s
            own = eccentric * part_of(s, h[s])[cut]
            out[rows, s] = eccentric * part_of(s, by_omega[s])[cut]
            out[rows, 2 + s] = eccentric * part_of(s, by_zeta[s])[cut]
            out[rows, 4 + s] = own  # ln amplitude in this sensor
            out[rows, 6 + s] = eccentric * part_of(s, 1j * h[s])[cut]  # phase
            out[rows, 8] = (1 if s == 0 else -1) * eccentric * part_of(o, h[o])[cut]  # axis angle
            moving = eccentric * part_of(s, rate[s])[cut]
            out[rows, 9 + s], out[rows, 11 + s] = -moving, -moving * (t - 0.5 * self.ramp_s)  # delay, drift
            out[rows, 13 + 6 * s] = 1.0
            out[rows, 14 + 6 * s] = t
            for k, (w, z) in enumerate(zip(p.natural_frequencies_rad_s, (p.zeta1, p.zeta2), strict=True)):
                free = np.exp(w * (-z + 1j * np.sqrt(complex(1 - z * z))) * t)  # free motion from before the ramp
                out[rows, 15 + 6 * s + 2 * k], out[rows, 16 + 6 * s + 2 * k] = free.real, free.imag
        prior = np.full(count, np.inf)
        prior[8], prior[9:11] = _AXIS_STD, _RUN_UP_DELAY_STD_S
        for s in range(2):
            prior[11 + s] = np.hypot(
                self.sensors.clock_rate_std("xy"[s], self.ramp_s), self.sensors.clock_rate_std("phase", self.ramp_s)
            )
        return out * weight[:, None], prior
