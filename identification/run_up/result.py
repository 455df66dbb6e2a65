"""Result of a passage's fit, and its conversion to the rig's parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification.clocks import clock_errors
from identification.curve import FittedCurve
from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from identification.fit_result import FitResult
from identification.mass_slopes import mass_slopes
from identification.ring_down.direction_terms import DirectionTerms
from identification.setting import ModelChoice
from rig_configs.error_label import ErrorLabel
from rig_configs.known import MASSES, ZERO_A, ZERO_B
from rig_configs.suspension_terms import TERMS

_MAX_CHI2 = 10.8  # of the difference of both sensors' eccentricities: P(χ² > 10.8) = 1e-3


@dataclass(frozen=True)
class RunUpFit(FitResult):
    """Fit of a run-up or run-down.

    Attributes:
        values: f1_Hz, zeta1, f2_Hz, zeta2 (of the stiffness axes closest to sensors x and y), axis_angle_deg,
            amplitude_x_m, amplitude_y_m (eccentricity of the rotor as measured by each sensor), phase_x_deg,
            phase_y_deg (of that eccentricity against ψ, from the first stiffness axis). With separate clocks of sensors
            and phase also delay_x_s, delay_y_s (laser against phase). With a slow roll also run_out_x_m, run_out_x_deg
            (sensor x shows Re(r e^{iψ}) at any speed, sensor y Im) and bow_x_m, bow_x_deg (of the springs' rest
            position, from the first stiffness axis), and growing_x_m, growing_x_deg (motion that grows with the square
            of the speed, at the fastest speed; as run-out), and the same for y. Values that the passage does not
            determine are absent; a warning names them.
        covariance: shape (n, n), in the order of the values; statistical, including the noise of the phase and a motion
            once per turn that the model does not contain.
        warnings: findings that limit the use of the values.
        curves: curves of both sensors.
        half_power: f_Hz and zeta from the peak and its width, for each sensor; biased by the sweep.
        noise: white noise of one sample of each sensor, m.
        chi2_per_dof: χ² of the residuals per degree of freedom, relative to white noise.
        vold_kalman: f_Hz and zeta of a steady-state curve through the Vold–Kalman amplitude, for each sensor; biased
            by the sweep.
        intervals: 95 % interval of each value, from the profile likelihood if the axes are badly resolved.
        model, model_table: description of the smallest adequate model, and the compared models (χ² + k ln n).
        terms: amplitude dependence of the suspension in each direction, if ring-downs determined one.
        with_terms: covariance of the values with H1, H2, Q1, Q2 of the terms, shape (n, 4).
        settled: whether the iteration converged. Values of other fits are not usable.
    """

    values: dict[str, float]
    covariance: np.ndarray
    warnings: list[str]
    curves: list[FittedCurve]
    half_power: dict[str, tuple[float, float]]
    noise: list[float]
    chi2_per_dof: float
    vold_kalman: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    model: str = ""
    model_table: list[ModelChoice] = field(default_factory=list[ModelChoice])
    settled: bool = True
    terms: list[DirectionTerms] = field(default_factory=list[DirectionTerms])
    with_terms: np.ndarray | None = None


def run_up_estimate(run: Run, fit: RunUpFit, physics: RotorParameters, gain_std: tuple[float, float]) -> Estimate:
    """Convert the fit of a run to k1, k2, ζ1, ζ2 and S_P. Parameters that the passage does not determine are absent.

    The sensors measure M_S A = |S_P + S_A e^{iθ3} + S_B e^{iθ4}| with the measured angles of the locked pendulums. S_P
    is the positive solution. The weights of the sensors follow from their statistical and gain errors. If the sensors
    contradict each other, half their difference is part of the uncertainty of S_P.

    Args:
        run: fitted run.
        fit: its fit.
        physics: masses and lengths.
        gain_std: relative standard uncertainty of the gains of laser x and y.
    Raises:
        NotIdentifiable: the fit contains no resonance or no amplitude.
    """
    mass = physics.total_mass_kg
    seen = [i for i in range(2) if f"amplitude_{'xy'[i]}_m" in fit.values]
    modes = [i for i in range(2) if f"f{i + 1}_Hz" in fit.values]
    if not seen or not modes:
        raise NotIdentifiable(f"{run.source}: the passage determines no resonance")
    wanted = [f"f{i + 1}_Hz" for i in modes] + [f"zeta{i + 1}" for i in modes]
    order = [list(fit.values).index(n) for n in (*wanted, *(f"amplitude_{'xy'[i]}_m" for i in seen))]
    raw = np.array(list(fit.values.values()))[order]
    covariance = fit.covariance[np.ix_(order, order)]
    m, amplitudes = len(modes), raw[2 * len(modes) :]
    gains = np.array([gain_std[i] for i in seen])
    weights = np.linalg.solve(covariance[2 * m :, 2 * m :] + np.diag((gains * amplitudes) ** 2), np.ones(len(seen)))
    weights /= weights.sum()
    moment = mass * float(weights @ amplitudes)
    locked = _locked_moment(run, physics)
    unbalance = float(np.sqrt(max(moment**2 - locked.imag**2, 0.0)) - locked.real)
    slope = moment / max(unbalance + locked.real, 1e-12)
    stiffness = mass * (2 * np.pi * raw[:m]) ** 2
    jacobian = np.zeros((2 * m + 1, len(order)))
    jacobian[range(m), range(m)] = 2 * stiffness / raw[:m]
    jacobian[range(m, 2 * m), range(m, 2 * m)] = 1.0
    jacobian[2 * m, 2 * m :] = slope * mass * weights
    spread = jacobian @ covariance @ jacobian.T
    spread[-1, -1] += (slope * mass * sensors_apart_m(fit, gain_std)) ** 2
    names = (*(f"k{i + 1}_N_per_m" for i in modes), *(f"zeta{i + 1}" for i in modes), "SP_kg_m")
    values = np.array([*stiffness, *raw[m : 2 * m], unbalance])
    shared = clock_errors(run, {"phase": np.r_[2 * stiffness, np.zeros(m + 1)]})
    for k, i in enumerate(seen):
        shift = slope * mass * weights[k] * amplitudes[k] * gains[k]
        shared[ErrorLabel("gain", "xy"[i])] = np.r_[np.zeros(2 * m), shift]
    with_terms = jacobian @ fit.with_terms[order] if fit.terms and fit.with_terms is not None else np.empty((0, 0))
    by_number = mass_slopes(names, values, mass)
    for number, change in _imbalance_slopes(_locked_angles(run), physics, locked, slope, moment / mass).items():
        own = by_number.get(number, np.zeros(len(names))).copy()
        own[-1] += change
        by_number[number] = own
    return Estimate(
        run.test,
        (run.source,),
        names,
        values,
        spread,
        shared,
        f"transient passage, separable least squares: {fit.model}",
        by_number,
        dict(zip(TERMS, with_terms.T, strict=False)),
    )


def sensors_apart_m(fit: RunUpFit, gain_std: tuple[float, float]) -> float:
    """Half the difference of the eccentricities by both sensors, m; 0 if it is within their errors.

    Both sensors measure the same eccentricity, each at its own resonance. If they contradict each other, the imbalance
    changed between the resonances, or the model does not hold at one of them. The standard uncertainty of the mean of
    two contradicting values by their own scatter is half their difference.
    """
    names = [f"amplitude_{axis}_m" for axis in "xy"]
    if not all(name in fit.values for name in names):
        return 0.0
    at = [list(fit.values).index(name) for name in names]
    x, y = (fit.values[name] for name in names)
    own = fit.covariance[np.ix_(at, at)] + np.diag([(gain_std[0] * x) ** 2, (gain_std[1] * y) ** 2])
    variance = float(own[0, 0] + own[1, 1] - 2 * own[0, 1])
    return 0.5 * abs(x - y) if (x - y) ** 2 > _MAX_CHI2 * variance else 0.0


def _imbalance_slopes(
    theta: np.ndarray, physics: RotorParameters, locked: complex, slope: float, eccentricity_m: float
) -> dict[str, float]:
    """Derivatives of S_P = √(M_S² A² − Im²) − Re, Re + i Im = Σ S_j e^{iθ_j}, by the known numbers.

    Args:
        theta: angles of the locked pendulums, shape (2,), rad.
        physics: masses and lengths.
        locked: Σ S_j e^{iθ_j}, kg m.
        slope: ∂S_P/∂(M_S A).
        eccentricity_m: eccentricity A, m.
    """
    found = dict.fromkeys(MASSES, slope * eccentricity_m)
    root = slope / (eccentricity_m * physics.total_mass_kg or 1.0)  # 1/(S_P + Re)
    for name, zero, pendulum, angle in (("a", ZERO_A, physics.a, theta[0]), ("b", ZERO_B, physics.b, theta[1])):
        cos, sin = float(np.cos(angle)), float(np.sin(angle))
        by_moment = -locked.imag * sin * root - cos
        found[f"pendulums.{name}.mass_kg"] += by_moment * pendulum.length_m
        found[f"pendulums.{name}.length_m"] = by_moment * pendulum.mass_kg
        found[zero] = pendulum.first_moment_kg_m * (locked.imag * cos * root - sin)  # a larger zero reduces the angle
    return found


def _locked_angles(run: Run) -> np.ndarray:
    """Angles θ3, θ4 of the locked pendulums, shape (2,), rad."""
    return np.mean(run.angle_rad, axis=0) if len(run.angle_rad) else np.array([0.0, np.pi])


def _locked_moment(run: Run, physics: RotorParameters) -> complex:
    """First mass moment of the locked pendulums in the rotor's frame, kg m."""
    theta = _locked_angles(run)
    a, b = physics.a.first_moment_kg_m, physics.b.first_moment_kg_m
    return complex(a * np.exp(1j * theta[0]) + b * np.exp(1j * theta[1]))
