"""Ring-down: natural frequencies, damping ratios and the sensors' axis angle from free decays.

Model and estimator: identification.ring_down.model and docs/theory/identification.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.signals import Run
from identification.curve import Curve
from identification.errors import FitFailed, NotIdentifiable
from identification.estimate import Estimate
from identification.least_squares import Solution, solve_separable
from identification.ring_down.model import SHARED, DecayRecord, model_of, single_block
from identification.ring_down.modes import damped_periodogram
from identification.ring_down.release_instant import release_instant
from identification.ring_down.start import lone_axis, ring_down_starts
from identification.samples import Averages, block_averages, clipped, correlation_inflation, white_noise

AXIS_PRIOR_STD = np.radians(3.0)  # how well the sensors are mounted
DELAY_STD_S = 3e-3  # between two lasers' clocks
_LEFT_OVER, _WRONG_CHI2 = 0.1, 10.0  # share of the signal and χ²/dof that mark a model that is none
_BLOCK_S = 1 / 250.0  # ≥ 20 samples a cycle up to 12.5 Hz


Attempt = Callable[[], tuple[Solution, list[list[Averages]]]]


@dataclass(frozen=True)
class RingDownFit:
    """What a ring-down says.

    Attributes:
        values: f1_Hz, zeta1 and, with a second mode, f2_Hz, zeta2, axis_angle_deg; with a mass k1_N_per_m, k2_N_per_m.
        covariance: of the values in their order, shape (n, n).
        warnings: what a reader must know.
        curves: per record and channel, from the release on.
        noise: white noise of one sample per channel, m.
        residual_rms: rms of the block averages' residuals per channel, m.
        chi2_per_dof: residuals against the white noise; 1 when the model is right.
        release_s: where each record's fit begins.
    """

    values: dict[str, float]
    covariance: np.ndarray
    warnings: list[str]
    curves: list[Curve]
    noise: list[float]
    residual_rms: list[float]
    chi2_per_dof: float
    release_s: list[float]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name (statistical; clocks not included)."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


@dataclass
class _Prepared:
    """Block averages of every record and what was noticed while making them."""

    channels: list[list[Averages]]
    starts: list[float] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def fit_ring_down(time_s: np.ndarray, displacement_m: np.ndarray, mass_kg: float | None = None) -> RingDownFit:
    """Fit a free decay.

    Args:
        time_s: shape (n,), s, ascending.
        displacement_m: shape (n,) for one sensor and one mode, or (n, 2) for sensors x and y on the same samples and
            two modes; m. NaN and railed samples are left out. Quiet, pull and hold before the release may be there.
        mass_kg: total moving mass; adds stiffnesses.
    Raises:
        NotIdentifiable: nothing rings down, or the record is too short.
        FitFailed: no convergence.
    Source: docs/theory/identification.md.
    """
    signals = np.asarray(displacement_m, float)
    if signals.ndim == 1:
        return _fit_one(_prepare([[(time_s, signals)]]), mass_kg, 0)
    return _fit_two(_prepare([[(time_s, signals[:, 0]), (time_s, signals[:, 1])]]), mass_kg)


def fit_ring_down_runs(runs: Sequence[Run], mass_kg: float | None = None) -> RingDownFit:
    """One joint fit of several ring-down runs: modes and axis angle shared, amplitudes and laser delay each run's own.

    Args:
        runs: "ring-down-x" and "ring-down-y" runs in any number.
        mass_kg: total moving mass.
    Raises:
        NotIdentifiable, FitFailed: as fit_ring_down.
    """
    pairs = [[(run.x_time_s, run.x_m), (run.y_time_s, run.y_m)] for run in runs]
    return _fit_two(_prepare(pairs), mass_kg)


def ring_down_estimate(run: Run, fit: RingDownFit) -> Estimate:
    """A run's fit in the joint estimate's form, its lasers' clocks as shared errors."""
    names = tuple(n for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2") if n in fit.values)
    order = [list(fit.values).index(n) for n in names]
    values = np.array([fit.values[n] for n in names])
    shared = {}
    for device, name in (("laser_x", "k1_N_per_m"), ("laser_y", "k2_N_per_m")):
        if name in names:  # k goes with the square of the clock's rate
            shift = 2 * values * clock_rate_std(run.clock_rate_std, device)
            shared[f"clock {device}"] = np.where(np.array(names) == name, shift, 0.0)
    return Estimate(
        run.test, run.source, names, values, fit.covariance[np.ix_(order, order)], shared,
        "two coupled decays, separable least squares",
    )  # fmt: skip


def clock_rate_std(rates: Mapping[str, float], device: str) -> float:
    """Relative standard uncertainty of a device's rate; 20 ppm when the run does not say."""
    return float(rates.get(device, 20e-6))


def _prepare(records: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]) -> _Prepared:
    prepared = _Prepared([])
    for record in records:
        channels = []
        for time, value in record:
            clean = np.array(value, float)
            noise = white_noise(clean)
            rail = clipped(clean)
            if rail.any():
                prepared.warnings.append(f"{np.count_nonzero(rail)} samples at the sensor's rail left out")
                clean[rail] = np.nan
            channels.append(block_averages(np.asarray(time, float), clean, _BLOCK_S, noise))
        prepared.channels.append(channels)
        prepared.starts.append(release_instant(channels))
    return prepared


def _cut(prepared: _Prepared) -> list[list[Averages]]:
    out = []
    for channels, start in zip(prepared.channels, prepared.starts, strict=True):
        cut = [c.between(start, np.inf) for c in channels]
        if any(len(c.time_s) < 40 for c in cut):
            raise NotIdentifiable(f"only {len(cut[0].time_s) * _BLOCK_S:.2g} s after the release; record longer")
        out.append(cut)
    return out


def _fit_one(prepared: _Prepared, mass: float | None, axis: int) -> RingDownFit:
    def attempt() -> tuple[Solution, list[list[Averages]]]:
        cut = _cut(prepared)
        channel = cut[0][axis]
        start = damped_periodogram(channel)
        theta = np.log([start.omega, start.zeta])
        free = np.full(2, np.inf)
        zero = channel.time_s[0]
        return solve_separable(lambda t: [single_block(channel, zero, t)], theta, theta, free), [[channel]]

    solution, cut = _with_later_starts(prepared, attempt)
    return _result(prepared, cut, solution, [f"f{axis + 1}_Hz", f"zeta{axis + 1}"], mass)


def _fit_two(prepared: _Prepared, mass: float | None) -> RingDownFit:
    lone = lone_axis(_cut(prepared))
    if lone is not None:
        axis, reason = lone
        prepared.warnings.append(f"{reason}; direction {axis + 1} alone is fitted. Add a ring-down along {'yx'[axis]}")
        return _fit_one(prepared, mass, axis)

    def attempt() -> tuple[Solution, list[list[Averages]]]:
        cut = _cut(prepared)
        records = [DecayRecord(x, y, float(x.time_s[0])) for x, y in cut]
        first, second = ring_down_starts(cut)
        delays = len(records)
        theta = np.zeros(SHARED + delays)
        theta[:4] = np.log([first.omega, first.zeta, second.omega, second.zeta])
        prior_std = np.r_[np.full(4, np.inf), AXIS_PRIOR_STD, 2e-3, np.full(delays, DELAY_STD_S)]
        return solve_separable(model_of(records), theta, np.zeros(SHARED + delays), prior_std), cut

    solution, cut = _with_later_starts(prepared, attempt)
    names = ["f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg"]
    return _result(prepared, cut, solution, names, mass)


def _with_later_starts(prepared: _Prepared, attempt: Attempt) -> tuple[Solution, list[list[Averages]]]:
    """Fit; where the residual right after the supposed release stands out, begin later and fit again."""
    solution, cut = attempt()
    for _ in range(12):
        early = _early_excess(solution, cut)
        if not any(early):
            break
        prepared.starts = [s + 0.1 if bad else s for s, bad in zip(prepared.starts, early, strict=True)]
        solution, cut = attempt()
    return solution, cut


def _early_excess(solution: Solution, cut: list[list[Averages]]) -> list[bool]:
    out = []
    for residual, channels in zip(solution.residuals, cut, strict=True):
        at, worst = 0, False
        for channel in channels:
            own = residual[at : at + len(channel.time_s)]
            at += len(own)
            early = channel.time_s < channel.time_s[0] + 0.2
            n = np.count_nonzero(early)
            level = float(np.mean(own[early] ** 2))
            later = float(np.mean(own[~early] ** 2))
            worst |= level > (1 + 6 * np.sqrt(2 / max(n, 1))) * max(1.0, later)
        out.append(worst)
    return out


def _result(
    prepared: _Prepared, cut: list[list[Averages]], solution: Solution, names: list[str], mass: float | None
) -> RingDownFit:
    minimum = solution.minimum
    if not minimum.converged or not np.all(np.isfinite(minimum.theta)):
        raise FitFailed(
            f"ring-down: no convergence in {minimum.iterations} iterations, χ²/dof {solution.chi2_per_dof:.3g}"
        )
    theta, n = minimum.theta, len(names)
    values, scale = np.empty(n), np.empty(n)
    for i, name in enumerate(names):
        if name == "axis_angle_deg":
            values[i], scale[i] = np.degrees(theta[i]), np.degrees(1.0)
        else:
            values[i] = np.exp(theta[i]) / (2 * np.pi if name.endswith("Hz") else 1.0)
            scale[i] = values[i]
    curves, rms, worst = [], [], 1.0
    at_record = zip(cut, solution.residuals, strict=True)
    for number, (channels, residual) in enumerate(at_record):
        at = 0
        for axis, channel in zip("xy", channels, strict=False):
            own = residual[at : at + len(channel.time_s)]
            at += len(own)
            worst = max(worst, correlation_inflation(own))
            metres = own / channel.weight
            left_over = float(np.std(metres) / np.std(channel.value))
            if left_over > _LEFT_OVER and solution.chi2_per_dof > _WRONG_CHI2:
                raise FitFailed(f"ring-down: the model leaves {left_over:.0%} of sensor {axis}'s signal")
            rms.append(float(np.sqrt(np.mean(metres**2))))
            curves.append(
                Curve(f"ring-down {number + 1}: {axis}", "m", channel.time_s, channel.value, channel.value - metres)
            )
    inflation = max(worst, np.sqrt(max(1.0, solution.chi2_per_dof)))
    covariance = minimum.covariance[:n, :n] * np.outer(scale, scale) * inflation**2
    table = dict(zip(names, values.tolist(), strict=True))
    table, covariance = _with_stiffness(table, covariance, mass)
    noise = [c.noise for channels in cut for c in channels]
    warnings = prepared.warnings + _remarks(table, covariance, solution.chi2_per_dof)
    return RingDownFit(table, covariance, warnings, curves, noise, rms, solution.chi2_per_dof, list(prepared.starts))


def _with_stiffness(
    table: dict[str, float], covariance: np.ndarray, mass: float | None
) -> tuple[dict[str, float], np.ndarray]:
    """k = M (2π f)² beside the frequencies."""
    if mass is None:
        return table, covariance
    jacobian = [np.eye(len(table))]
    out = dict(table)
    for i, name in enumerate(table):
        if name.endswith("_Hz"):
            out[f"k{name[1]}_N_per_m"] = mass * (2 * np.pi * table[name]) ** 2
            jacobian.append(np.eye(len(table))[i : i + 1] * 2 * mass * (2 * np.pi) ** 2 * table[name])
    full = np.concatenate(jacobian)
    return out, full @ covariance @ full.T


def _remarks(table: dict[str, float], covariance: np.ndarray, chi2: float) -> list[str]:
    out = []
    if "axis_angle_deg" in table:
        std = float(np.sqrt(covariance[4, 4]))
        if std > 2.0:
            out.append(
                f"axes not resolved: both directions ring alike and the axis angle stays uncertain by {std:.2g}°; "
                "directions 1 and 2 are the sensors'"
            )
    if chi2 > 1.3:
        out.append(f"residuals exceed the sensor noise: χ²/dof {chi2:.3g}; standard deviations are scaled up")
    return out
