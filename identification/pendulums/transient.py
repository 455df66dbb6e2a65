"""Pendulum damping from the full coupled motion: after a flick on a resting rotor, after a release at speed.

The pendulums shake the disk and the disk pushes back at the per cent level, so the encoder angles are fitted with the
nonlinear model itself. What else the motion depends on (suspension, imbalance, start state, encoder zeros) is free
within what is known of it; the quoted uncertainty contains it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dynamics.integrate import fastest_rate, integrate
from dynamics.parameters import RotorParameters
from identification.curve import Curve
from identification.least_squares import Minimum, minimise
from identification.pendulums.suspension_knowledge import Knowledge
from identification.samples import Averages, correlation_inflation

Predict = Callable[[np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class TransientFit:
    """What a pendulum transient says.

    Attributes:
        values: c3_Nms_per_rad, c4_Nms_per_rad.
        covariance: shape (2, 2).
        curves: both pendulums, measured and fitted.
        chi2_per_dof: residuals against the encoder's white noise.
        horizon_s: length of the fitted stretch.
        start_angles_rad: θ3, θ4 at its beginning.
        warnings: what a reader must know.
    """

    values: dict[str, float]
    covariance: np.ndarray
    curves: list[Curve]
    chi2_per_dof: float
    horizon_s: float
    start_angles_rad: tuple[float, float]
    warnings: list[str]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name (clock not included)."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


@dataclass(frozen=True)
class TransientProblem:
    """One transient as nonlinear least squares; θ begins with ln c3, ln c4.

    Attributes:
        angles: block averages of both encoders from the transient's start on.
        predict: (θ, last instant) ↦ both angles at every block up to it, one array after the other.
        difference: step of each parameter's finite difference, shape (p,).
        prior, prior_std: independent Gaussian knowledge of θ, shape (p,); std inf where there is none.
    """

    angles: tuple[Averages, Averages]
    predict: Predict
    difference: np.ndarray
    prior: np.ndarray
    prior_std: np.ndarray

    def cut(self, end_s: float) -> tuple[Averages, Averages]:
        """The data up to an instant."""
        return self.angles[0].between(-np.inf, end_s), self.angles[1].between(-np.inf, end_s)

    def solve(self, start: np.ndarray, end_s: float, iterations: int = 25) -> Minimum:
        """Least squares on the data up to end_s."""
        data = self.cut(end_s)
        measured = np.concatenate([d.value for d in data])
        weight = np.concatenate([d.weight for d in data])
        known = np.isfinite(self.prior_std)
        rows = np.eye(len(start))[known] / self.prior_std[known, None]

        def evaluate(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            base = self.predict(theta, end_s)
            columns = []
            for j, step in enumerate(self.difference):
                moved = theta.copy()
                moved[j] += step
                columns.append((self.predict(moved, end_s) - base) / step * weight)
            residual = np.r_[(base - measured) * weight, rows @ (theta - np.where(known, self.prior, 0.0))]
            if not np.all(np.isfinite(base)):
                return np.full(len(residual), np.inf), np.zeros((len(residual), len(theta)))
            return residual, np.concatenate([np.column_stack(columns), rows])

        return minimise(evaluate, start, iterations)

    def chi2_per_dof(self, minimum: Minimum, end_s: float) -> float:
        """Reduced χ² of the data alone."""
        n = sum(len(d.time_s) for d in self.cut(end_s))
        data = minimum.residual[:n]
        return float(data @ data) / max(1, n - 6)

    def result(self, minimum: Minimum, end_s: float, label: str, angles_at: int) -> TransientFit:
        """A minimum as the numbers that are reported; angles_at is where θ3 and θ4 stand in θ."""
        data = self.cut(end_s)
        chi2 = self.chi2_per_dof(minimum, end_s)
        inflation, curves, at = np.sqrt(max(1.0, chi2)), [], 0
        for name, channel in zip("AB", data, strict=True):
            own = minimum.residual[at : at + len(channel.time_s)]
            at += len(own)
            inflation = max(inflation, correlation_inflation(own))
            fitted = channel.value + own / channel.weight
            curves.append(Curve(f"{label}: {name}", "rad", channel.time_s, channel.value, fitted))
        c = np.exp(minimum.theta[:2])
        covariance = minimum.covariance[:2, :2] * np.outer(c, c) * inflation**2
        values = {"c3_Nms_per_rad": float(c[0]), "c4_Nms_per_rad": float(c[1])}
        start = (float(minimum.theta[angles_at]), float(minimum.theta[angles_at + 1]))
        horizon = end_s - self.angles[0].time_s[0]
        warnings = []
        if chi2 > 1.3:
            warnings.append(
                f"{label}: residuals exceed the encoder noise: χ²/dof {chi2:.3g}; standard deviations are scaled up"
            )
        return TransientFit(values, covariance, curves, chi2, horizon, start, warnings)


def laid_over(knowledge: Knowledge, damping: np.ndarray, suspension: np.ndarray) -> RotorParameters:
    """Parameters from ln c3, ln c4 and the logarithms of k1, k2, ζ1, ζ2 and (if there) S_P."""
    names = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
    values = dict(zip(names, np.exp(suspension).tolist(), strict=False))
    c3, c4 = np.exp(damping).tolist()
    return knowledge.physics.with_values(c3_Nms_per_rad=c3, c4_Nms_per_rad=c4, **values)


def log_suspension(physics: RotorParameters) -> np.ndarray:
    """Logarithms of k1, k2, ζ1, ζ2, S_P, shape (5,)."""
    p = physics
    return np.log([p.k1_N_per_m, p.k2_N_per_m, p.zeta1, p.zeta2, p.imbalance_moment_kg_m])


def free_angles(
    physics: RotorParameters,
    knots: np.ndarray,
    coefficients: np.ndarray,
    start: np.ndarray,
    start_s: float,
    angles: tuple[Averages, Averages],
    step_s: float,
    output_s: float,
) -> np.ndarray:
    """Both angles at the blocks' mean times from a state at start_s, both pendulums free; concatenated.

    NaN where the motion cannot be integrated with this step (a trial far outside): the minimiser refuses such a trial.
    """
    last = max(float(a.time_s[-1]) for a in angles)
    grid = start_s + output_s * np.arange(int(np.ceil((last - start_s) / output_s)) + 2)
    states = integrate(start, grid, step_s, knots, coefficients, physics.packed(), 1.0, 1.0)
    if not np.all(np.isfinite(states)):
        return np.full(sum(len(a.time_s) for a in angles), np.nan)
    out = []
    for i, channel in enumerate(angles):
        spline = CubicHermiteSpline(grid, states[:, 2 + i], states[:, 6 + i])
        curve = spline(channel.time_s, 2)
        out.append(spline(channel.time_s) + 0.5 * channel.spread_s2 * curve)
    return np.concatenate(out)


def step_for(physics: RotorParameters, speed_rad_s: float, share: float) -> float:
    """An integration step: a share of the fastest rate's inverse."""
    return share / fastest_rate(physics, speed_rad_s)
