"""One quantity of one point: measured against predicted, with what the difference's uncertainty is made of.

In the terms of ASME V&V 20: E = measured − predicted, u_D of the measurement, u_input of the numbers that went into
the prediction, u_num of its integration, and u_val of E, in which an error that enters both sides counts with the
difference of its two effects. The model's error lies in E ± 1.96 u_val in 95 % of cases; z = E/u_val is from the same
row. Where the model says "no vibration" an amplitude cannot be below it: there the order-1 amplitudes are held against
their noise.
Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scipy.special import ndtri_exp

from analysis.differences import held_variance, measured_shifts
from analysis.prediction import QUANTITIES, Prediction
from analysis.steady_state import SteadyMeasurement
from rig_configs import Rig

Z_LIMIT = 4.0
_NORMAL_95 = 1.96
NAMES = {
    "theta3": "θ3",
    "theta4": "θ4",
    "amplitude_x": "x amplitude",
    "amplitude_y": "y amplitude",
    "amplitude": "rms amplitude",
}
JSON_KEYS = {
    "theta3": ("theta3_deg", 180 / math.pi),
    "theta4": ("theta4_deg", 180 / math.pi),
    "amplitude": ("amplitude_mm", 1e3),
    "amplitude_x": ("amplitude_x_mm", 1e3),
    "amplitude_y": ("amplitude_y_mm", 1e3),
}


@dataclass(frozen=True)
class Score:
    """How one quantity's z came about, so that a reader can work it out again; rad and m.

    Attributes:
        z: (measured − predicted) / u_validation, or for an amplitude where none is predicted the
            |z| of the same probability as noise.
        measured, measured_std, predicted, predicted_std: what was compared.
        error: measured − predicted; of angles the shorter way round.
        noise: of an amplitude where none is predicted: standard deviations of the real or imaginary part, one for x, y
            or both; empty for a difference.
        u_numerical: standard uncertainty of the prediction's integration.
        u_validation: of measured − predicted: what both share counts once. The model's error lies within
            error ± 1.96 u_validation in 95 % of cases.
        chi2, p: of noise: Σ|X|²/σ² and how often noise alone reaches it; chi2 has twice as many degrees of freedom as
            there are deviations.
    """

    z: float
    measured: float
    measured_std: float
    predicted: float
    predicted_std: float
    noise: tuple[float, ...] = ()
    chi2: float = math.nan
    p: float = math.nan
    error: float = math.nan
    u_numerical: float = 0.0
    u_validation: float = math.nan

    def to_json(self, key: tuple[str, float]) -> dict[str, Any]:
        """Plain values in the unit of a key (name with unit, factor); what is not known is None."""
        unit, factor = key[0].rpartition("_")[2], key[1]
        numbers = {
            f"measured_{unit}": self.measured * factor,
            f"measured_std_{unit}": self.measured_std * factor,
            f"predicted_{unit}": self.predicted * factor,
            f"predicted_std_{unit}": self.predicted_std * factor,
        }
        if not self.noise and math.isfinite(self.u_validation):
            reach = _NORMAL_95 * self.u_validation
            error = self.error
            numbers |= {
                f"error_{unit}": error * factor,
                f"u_numerical_{unit}": self.u_numerical * factor,
                f"u_validation_{unit}": self.u_validation * factor,
                f"model_error_low_{unit}": (error - reach) * factor,
                f"model_error_high_{unit}": (error + reach) * factor,
            }
        found: dict[str, Any] = {"statistic": "noise" if self.noise else "difference"}
        found |= {name: finite(value) for name, value in numbers.items()}
        if self.noise:
            found |= {
                f"noise_{unit}": [finite(s * factor) for s in self.noise],
                "chi2": finite(self.chi2),
                "dof": 2 * len(self.noise),
                "p": self.p,
            }
        return found | {"z": finite(self.z)}


def scores_of(measured: SteadyMeasurement, prediction: Prediction, rig: Rig) -> dict[str, Score]:
    """Every quantity of a point, by name.

    Args:
        rig: gains' and zeros' uncertainties, and what is allowed for the model.
    """
    values, std = measured_intervals(measured), prediction.std
    seen, scores = measured_shifts(measured, rig), dict[str, Score]()
    granted = (math.radians(rig.validation.model_std_deg), 1e-3 * rig.validation.model_std_mm)
    for j, name in enumerate(QUANTITIES):
        value, model = values[name].value, float(prediction.values[j])
        error = value - model
        if j < 2:
            error = (error + math.pi) % (2 * math.pi) - math.pi
        numerical = float(prediction.numerical[j])
        variance = float(measured.own[j, j] + prediction.covariance[j, j]) + numerical**2 + granted[j > 1] ** 2
        for label in dict.fromkeys([*seen, *prediction.shared]):  # what both share counts with the difference of both
            here, there = (float(side[label][j]) if label in side else 0.0 for side in (seen, prediction.shared))
            variance += (here - there) ** 2 - there**2
        u = math.sqrt(max(variance, 1e-300))
        scores[name] = Score(
            error / u, value, values[name].std, model, float(std[j]), error=error, u_numerical=numerical, u_validation=u
        )
    if prediction.at_rest:
        scores |= _noise_scores(measured, prediction)
    return scores


def _noise_scores(measured: SteadyMeasurement, prediction: Prediction) -> dict[str, Score]:
    """Of amplitudes where none is predicted: held against noise, what was still to come and what friction leaves."""
    left_x, left_y = held_variance(prediction).tolist()
    noise_x, noise_y = math.hypot(measured.noise_x_m, left_x**0.5), math.hypot(measured.noise_y_m, left_y**0.5)
    x, y = abs(measured.x_m), abs(measured.y_m)
    rms = measured.amplitude_m
    looks = {
        "amplitude_x": ([x], [noise_x], x, noise_x),
        "amplitude_y": ([y], [noise_y], y, noise_y),
        "amplitude": ([x, y], [noise_x, noise_y], rms.value, math.hypot(noise_x, noise_y)),
    }
    scores = {}
    for name, (amplitudes, noise, value, std) in looks.items():
        chi2 = _chi2(amplitudes, noise)
        p = math.exp(_log_p(chi2, len(noise)))
        scores[name] = Score(balanced_z(amplitudes, noise), value, std, 0.0, 0.0, tuple(noise), chi2, p, value)
    return scores


def balanced_z(amplitudes_m: Sequence[float], stds_m: Sequence[float]) -> float:
    """|z| of amplitudes that should be noise alone.

    Args:
        amplitudes_m: |X| of complex order amplitudes, m.
        stds_m: standard deviation of the real and of the imaginary part of each, m.
    Returns:
        The |z| that a normal number exceeds as rarely as noise exceeds Σ|X|²/σ² (χ² with two degrees of freedom
        per amplitude). One or two amplitudes.
    """
    return float(-ndtri_exp(_log_p(_chi2(amplitudes_m, stds_m), len(amplitudes_m)) - math.log(2)))


def _chi2(amplitudes_m: Sequence[float], stds_m: Sequence[float]) -> float:
    return float(sum((a / s) ** 2 for a, s in zip(amplitudes_m, stds_m, strict=True)))


def _log_p(chi2: float, amplitudes: int) -> float:
    """Logarithm of how often noise in one or two complex amplitudes reaches a χ²."""
    return -chi2 / 2 + (math.log1p(chi2 / 2) if amplitudes == 2 else 0.0)


def sentence(name: str, score: Score) -> str:
    """One quantity that is off, in words, with both uncertainties."""
    if score.noise:
        noise = " and ".join(f"{s * 1e6:.2g}" for s in score.noise)
        return (
            f"{NAMES[name]} {score.measured * 1e6:.2f} µm measured where none is predicted, noise of {noise} µm alone "
            f"gives χ² = {score.chi2:.3g} on {2 * len(score.noise)}, z = {score.z:.1f}"
        )
    factor, unit = (180 / math.pi, "°") if name.startswith("theta") else (1e3, " mm")
    smaller = min(s for s in (score.measured_std, score.predicted_std, math.inf) if s > 0) * factor
    digits = max(2, min(6, 1 - math.floor(math.log10(max(smaller, 1e-6)))))
    pairs = [
        f"{value * factor:.{digits}f} ± {std * factor:.{digits}f}{unit}"
        for value, std in ((score.measured, score.measured_std), (score.predicted, score.predicted_std))
    ]
    return f"{NAMES[name]} {pairs[0]} measured against {pairs[1]} predicted, z = {score.z:.1f}"


def measured_intervals(m: SteadyMeasurement) -> dict[str, Any]:
    """What was measured, by quantity."""
    return {
        "theta3": m.theta_rad[0],
        "theta4": m.theta_rad[1],
        "amplitude_x": m.amplitude_x_m,
        "amplitude_y": m.amplitude_y_m,
        "amplitude": m.amplitude_m,
    }


def finite(value: float) -> float | None:
    """A number that JSON can hold."""
    return float(value) if math.isfinite(value) else None
