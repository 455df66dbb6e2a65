"""Run-up: both resonances, damping ratios and the imbalance from one passage, whatever the ramp's rate.

The full transient is fitted, so there is no sweep-rate bias; the half-power reading is given beside it for comparison.
Model and estimator: docs/theory/identification.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.signals import Run
from dynamics.errors import OutsideDomain
from dynamics.parameters import RotorParameters
from dynamics.speed_history import SpeedHistory
from identification.curve import Curve
from identification.errors import FitFailed, NotIdentifiable
from identification.estimate import Estimate
from identification.least_squares import Solution, solve_separable
from identification.ring_down.fit import AXIS_PRIOR_STD, clock_rate_std
from identification.run_up.forced_oscillator import Drive
from identification.run_up.model import ANGLE, DELAYS, DRIFTS, PARAMETERS, RunUpRecord, run_up_blocks
from identification.run_up.start import half_power, transfer_function_start
from identification.samples import block_averages, clipped, correlation_inflation, white_noise

_BLOCK_S = 1 / 320.0
_SKIPPED_MARKS = 2  # the spline's end piece has no neighbour to hold it
_DELAY_STD_S = 10e-3
_PAD_S = 0.05
_LEFT_OVER = 0.1  # share of the signal that marks a model that is none

# Over whole campaigns through real bytes ζ1 scattered 1.07 times as much as the fit's covariance says, with two of 34
# values near 2.8 (docs/benchmarks.md). Why is not known yet; until it is, the intervals are this much wider.
_DAMPING_STRETCH = 1.15


@dataclass(frozen=True)
class RunUpFit:
    """What a run-up says.

    Attributes:
        values: f1_Hz, zeta1, f2_Hz, zeta2, axis_angle_deg, amplitude_x_m, amplitude_y_m (eccentricity of everything
            that turns, as each sensor sees it), delay_x_s, delay_y_s (laser against tachometer).
        covariance: shape (n, n), in the values' order.
        warnings: what a reader must know.
        curves: both sensors.
        half_power: the naive answer from the peak's width, per sensor: f_Hz and zeta; biased by the sweep.
        noise, chi2_per_dof: white noise of one sample per sensor (m), residuals against it.
    """

    values: dict[str, float]
    covariance: np.ndarray
    warnings: list[str]
    curves: list[Curve]
    half_power: dict[str, tuple[float, float]]
    noise: list[float]
    chi2_per_dof: float

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name (statistical; gains and clocks not included)."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def fit_run_up(time_s: np.ndarray, displacement_m: np.ndarray, phase_rad: np.ndarray) -> RunUpFit:
    """Fit a run-up sampled on one time base.

    Args:
        time_s: shape (n,), s.
        displacement_m: shape (n, 2), sensors x and y, m; NaN and railed samples are left out.
        phase_rad: rotor phase ψ at the same samples, shape (n,), unwrapped; ψ = 0 has the imbalance along +x.
    Raises:
        NotIdentifiable: the speed never passes a resonance, or too few samples.
        FitFailed: no convergence.
    Source: docs/theory/identification.md.
    """
    signals = np.asarray(displacement_m, float)
    every = max(1, round(5e-3 / float(np.median(np.diff(time_s)))))
    moving = np.flatnonzero(np.abs(np.diff(phase_rad[::every])) > 0)
    first = max(0, int(moving[0]) - 1) * every if len(moving) else 0
    history = SpeedHistory.from_phases(time_s[first::every], phase_rad[first::every])
    start, end = history.knots_s[0], history.knots_s[-1]
    return _fit([(time_s, signals[:, 0]), (time_s, signals[:, 1])], history, start, end, (2e-5, 2e-5))


def fit_run_up_run(run: Run) -> RunUpFit:
    """The same on a recorded run: both sensors on their own clocks, the phase from the tachometer marks.

    Raises:
        NotIdentifiable: fewer than ten marks, or a passage that holds no resonance.
        FitFailed: no convergence.
    """
    if len(run.mark_time_s) < 10:
        raise NotIdentifiable(f"{run.source}: {len(run.mark_time_s)} tachometer marks; a run-up needs ten")
    try:
        history = SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad)
    except OutsideDomain as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    rates = run.clock_rate_std
    drift = tuple(
        float(np.hypot(clock_rate_std(rates, d), clock_rate_std(rates, "encoder"))) for d in ("laser_x", "laser_y")
    )
    sensors = [(run.x_time_s, run.x_m), (run.y_time_s, run.y_m)]
    return _fit(sensors, history, run.mark_time_s[_SKIPPED_MARKS], run.mark_time_s[-2], drift)


def run_up_estimate(run: Run, fit: RunUpFit, physics: RotorParameters, gain_std: tuple[float, float]) -> Estimate:
    """A run's fit as k1, k2, ζ1, ζ2 and S_P.

    The sensors see M_S A = |S_P + S_A e^{iθ3} + S_B e^{iθ4}| with the pendulums' locked angles as measured; S_P is
    the positive solution. The two sensors are weighted by their statistics and gains together.

    Args:
        gain_std: relative standard uncertainty of the gains of laser x and y.
    """
    mass = physics.total_mass_kg
    order = [list(fit.values).index(n) for n in ("f1_Hz", "f2_Hz", "zeta1", "zeta2", "amplitude_x_m", "amplitude_y_m")]
    raw = np.array(list(fit.values.values()))[order]
    covariance = fit.covariance[np.ix_(order, order)]
    gains = np.array(gain_std)
    total = covariance[4:, 4:] + np.diag((gains * raw[4:]) ** 2)
    weights = np.linalg.solve(total, np.ones(2))
    weights /= weights.sum()
    moment = mass * float(weights @ raw[4:])
    locked = _locked_moment(run, physics)
    unbalance = float(np.sqrt(max(moment**2 - locked.imag**2, 0.0)) - locked.real)
    slope = moment / max(unbalance + locked.real, 1e-12)
    stiffness = mass * (2 * np.pi * raw[:2]) ** 2
    jacobian = np.zeros((5, 6))
    jacobian[[0, 1], [0, 1]] = 2 * stiffness / raw[:2]
    jacobian[[2, 3], [2, 3]] = _DAMPING_STRETCH
    jacobian[4, 4:] = slope * mass * weights
    names = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
    values = np.array([*stiffness, *raw[2:4], unbalance])
    shared = {"clock encoder": np.r_[2 * stiffness * clock_rate_std(run.clock_rate_std, "encoder"), 0, 0, 0]}
    for i, axis in enumerate("xy"):
        shift = slope * mass * weights[i] * raw[4 + i] * gains[i]
        shared[f"gain laser_{axis}"] = np.array([0, 0, 0, 0, shift])
    return Estimate(
        run.test, run.source, names, values, jacobian @ covariance @ jacobian.T, shared,
        "transient passage through both resonances, separable least squares",
    )  # fmt: skip


def _locked_moment(run: Run, physics: RotorParameters) -> complex:
    """First mass moment of the locked pendulums in the rotor's frame, kg m."""
    theta = np.mean(run.angle_rad, axis=0) if len(run.angle_rad) else np.array([0.0, np.pi])
    a, b = physics.a.first_moment_kg_m, physics.b.first_moment_kg_m
    return complex(a * np.exp(1j * theta[0]) + b * np.exp(1j * theta[1]))


def _fit(
    sensors: list[tuple[np.ndarray, np.ndarray]],
    history: SpeedHistory,
    start: float,
    end: float,
    drift_std: tuple[float, ...],
) -> RunUpFit:
    warnings: list[str] = []
    channels = []
    start = max(start, *(float(t[0]) for t, _ in sensors))
    end = min(end, *(float(t[-1]) for t, _ in sensors))
    for time, value in sensors:
        clean = np.array(value, float)
        noise = white_noise(clean)
        rail = clipped(clean)
        if rail.any():
            warnings.append(f"{np.count_nonzero(rail)} samples at the sensor's rail left out")
            clean[rail] = np.nan
        channels.append(block_averages(time, clean, _BLOCK_S, noise).between(start + _PAD_S, end - _PAD_S))
    if min(len(c.time_s) for c in channels) < 400:
        raise NotIdentifiable("the run-up holds less than two seconds with a known phase")
    drive = Drive.from_history(history, start, end)
    record = RunUpRecord(channels[0], channels[1], drive)
    theta = np.zeros(PARAMETERS)
    for i, channel in enumerate(channels):
        theta[2 * i : 2 * i + 2] = np.log(transfer_function_start(channel, drive, imaginary=i == 1))
    prior_std = np.full(PARAMETERS, np.inf)
    prior_std[ANGLE], prior_std[DELAYS] = AXIS_PRIOR_STD, _DELAY_STD_S
    prior_std[DRIFTS] = drift_std
    top = float(history.phase(end)[0, 1])
    for i in range(2):
        if np.exp(theta[2 * i]) > 1.02 * top:
            raise NotIdentifiable(f"the run-up to {top * 30 / np.pi:.0f} rpm does not pass resonance {i + 1}")
    solution = solve_separable(lambda t: run_up_blocks(record, t), theta, np.zeros(PARAMETERS), prior_std)
    return _result(record, solution, history, warnings)


def _result(record: RunUpRecord, solution: Solution, history: SpeedHistory, warnings: list[str]) -> RunUpFit:
    minimum, theta = solution.minimum, solution.minimum.theta
    if not minimum.converged or not np.all(np.isfinite(theta)):
        raise FitFailed(
            f"run-up: no convergence in {minimum.iterations} iterations, χ²/dof {solution.chi2_per_dof:.3g}"
        )
    if np.exp(max(theta[0], theta[2])) > history.phase(record.drive.end_s)[0, 1]:
        raise NotIdentifiable("the run-up does not pass both resonances; run it up further")
    inflation = np.sqrt(max(1.0, solution.chi2_per_dof))
    curves, naive = [], {}
    for axis, channel, residual in zip("xy", record.channels, solution.residuals, strict=True):
        metres = residual / channel.weight
        if np.std(metres) > _LEFT_OVER * np.std(channel.value):
            raise FitFailed(
                f"run-up: the model leaves {np.std(metres) / np.std(channel.value):.0%} of sensor {axis}'s signal; "
                "does the run pass both resonances with the pendulums locked?"
            )
        inflation = max(inflation, correlation_inflation(residual))
        curves.append(Curve(f"run-up: {axis}", "m", channel.time_s, channel.value, channel.value - metres))
        naive[axis] = half_power(channel, history)
    values, covariance = _values(solution)
    if solution.chi2_per_dof > 1.3:
        warnings.append(
            f"run-up residuals exceed the sensor noise: χ²/dof {solution.chi2_per_dof:.3g}; "
            "standard deviations are scaled up"
        )
    noise = [c.noise for c in record.channels]
    return RunUpFit(values, covariance * inflation**2, warnings, curves, naive, noise, solution.chi2_per_dof)


def _values(solution: Solution) -> tuple[dict[str, float], np.ndarray]:
    """Reported numbers and their covariance from θ and the two complex amplitudes."""
    theta = solution.minimum.theta
    p = len(theta)
    joint = np.zeros((p + 4, p + 4))
    for i, both in enumerate(solution.coefficient_covariances):
        rows = np.r_[np.arange(p), p + 2 * i, p + 2 * i + 1]
        joint[np.ix_(rows, rows)] = both[: p + 2, : p + 2]
    # the sensors' amplitudes are correlated only through θ
    inverse = np.linalg.pinv(joint[:p, :p], hermitian=True)
    joint[p : p + 2, p + 2 :] = joint[p : p + 2, :p] @ inverse @ joint[:p, p + 2 :]
    joint[p + 2 :, p : p + 2] = joint[p : p + 2, p + 2 :].T
    amplitudes = [np.hypot(c[0], c[1]) for c in solution.coefficients]
    names = [
        "f1_Hz",
        "zeta1",
        "f2_Hz",
        "zeta2",
        "axis_angle_deg",
        "amplitude_x_m",
        "amplitude_y_m",
        "delay_x_s",
        "delay_y_s",
    ]
    f = np.exp(theta[:4]) / np.array([2 * np.pi, 1, 2 * np.pi, 1])
    values = [*f, np.degrees(theta[ANGLE]), *amplitudes, *theta[DELAYS]]
    jacobian = np.zeros((9, p + 4))
    jacobian[range(4), range(4)] = f
    jacobian[4, ANGLE] = np.degrees(1.0)
    for i, (c, size) in enumerate(zip(solution.coefficients, amplitudes, strict=True)):
        jacobian[5 + i, p + 2 * i : p + 2 * i + 2] = c[:2] / size
        jacobian[7 + i, DELAYS.start + i] = 1.0
    return dict(zip(names, (float(v) for v in values), strict=True)), jacobian @ joint @ jacobian.T
