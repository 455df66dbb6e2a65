"""Score of one quantity of one point: measured against predicted, with the contributions to the uncertainty.

Terms of ASME V&V 20: E = measured − predicted, u_D of the measurement, u_input of the inputs of the prediction, u_num
of its integration, and u_val of E. An error that enters both sides counts in u_val with the difference of its two
effects. The model's error lies in E ± 1.96 u_val in 95 % of cases; z = E/u_val. Where the model predicts no vibration
an amplitude cannot be smaller than predicted. There the order-1 amplitudes are compared with their noise.
Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

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


class Displayed(NamedTuple):
    """Unit in which a quantity is displayed.

    Attributes:
        key: name of the quantity with the unit, in JSON.
        factor: displayed value over SI value.
        unit: "deg" or "mm".
    """

    key: str
    factor: float
    unit: str

    @property
    def is_angle(self) -> bool:
        """Whether the quantity is an angle."""
        return self.unit == "deg"


DISPLAYED: Mapping[str, Displayed] = {
    "theta3": Displayed("theta3_deg", 180 / math.pi, "deg"),
    "theta4": Displayed("theta4_deg", 180 / math.pi, "deg"),
    "amplitude": Displayed("amplitude_mm", 1e3, "mm"),
    "amplitude_x": Displayed("amplitude_x_mm", 1e3, "mm"),
    "amplitude_y": Displayed("amplitude_y_mm", 1e3, "mm"),
}


@dataclass(frozen=True)
class Score:
    """Score of one quantity with all numbers behind its z; rad and m.

    Attributes:
        z: (measured − predicted) / u_validation. For an amplitude with no predicted vibration: the |z| of the same
            probability as noise.
        measured, measured_std, predicted, predicted_std: compared values and their standard uncertainties.
        error: measured − predicted; of angles within half a turn.
        noise: standard deviations of the real or imaginary part, one for x, y or both, of an amplitude with no
            predicted vibration; empty for a difference.
        u_numerical: standard uncertainty of the prediction's integration.
        u_validation: standard uncertainty of measured − predicted; errors of both sides count once. The model's error
            lies within error ± 1.96 u_validation in 95 % of cases.
        chi2, p: of noise: Σ|X|²/σ² and the probability that noise alone exceeds it. The degrees of freedom of chi2 are
            twice the number of deviations.
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

    def to_json(self, shown: Displayed) -> dict[str, Any]:
        """Return plain values in the displayed unit; unknown values are None."""
        unit, factor = shown.unit, shown.factor
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
    """Return the score of every quantity of a point, by name.

    Args:
        measured: measurement of the point.
        prediction: prediction for its speed.
        rig: rig file with the uncertainties of gains and zeros, and the allowance for the model.
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
        for label in dict.fromkeys([*seen, *prediction.shared]):  # errors of both sides count with their difference
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
    """Return scores of amplitudes with no predicted vibration, against noise, remaining approach and friction."""
    left_x, left_y = held_variance(prediction).tolist()
    noise_x, noise_y = math.hypot(measured.noise_x_m, left_x**0.5), math.hypot(measured.noise_y_m, left_y**0.5)
    x, y = abs(measured.x_m), abs(measured.y_m)
    rms = measured.amplitude_m
    looks = {
        "amplitude_x": ([x], [noise_x], x, noise_x),
        "amplitude_y": ([y], [noise_y], y, noise_y),
        "amplitude": ([x, y], [noise_x, noise_y], rms.value, math.hypot(noise_x, noise_y)),
    }
    scores: dict[str, Score] = {}
    for name, (amplitudes, noise, value, std) in looks.items():
        chi2 = _chi2(amplitudes, noise)
        p = math.exp(_log_p(chi2, len(noise)))
        scores[name] = Score(balanced_z(amplitudes, noise), value, std, 0.0, 0.0, tuple(noise), chi2, p, value)
    return scores


def balanced_z(amplitudes_m: Sequence[float], stds_m: Sequence[float]) -> float:
    """Return the |z| of amplitudes that should consist of noise alone.

    Args:
        amplitudes_m: |X| of complex order amplitudes, m.
        stds_m: standard deviation of the real and of the imaginary part of each, m.
    Returns:
        The |z| that a normal variable exceeds with the probability that noise exceeds Σ|X|²/σ² (χ² with two degrees
        of freedom per amplitude). Valid for one or two amplitudes.
    """
    return float(-ndtri_exp(_log_p(_chi2(amplitudes_m, stds_m), len(amplitudes_m)) - math.log(2)))


def _chi2(amplitudes_m: Sequence[float], stds_m: Sequence[float]) -> float:
    return float(sum((a / s) ** 2 for a, s in zip(amplitudes_m, stds_m, strict=True)))


def _log_p(chi2: float, amplitudes: int) -> float:
    """Return the logarithm of the probability that noise in one or two complex amplitudes exceeds a χ²."""
    return -chi2 / 2 + (math.log1p(chi2 / 2) if amplitudes == 2 else 0.0)


def sentence(name: str, score: Score) -> str:
    """Describe one deviating quantity with both uncertainties."""
    if score.noise:
        noise = " and ".join(f"{s * 1e6:.2g}" for s in score.noise)
        return (
            f"{NAMES[name]} {score.measured * 1e6:.2f} µm measured where none is predicted, noise of {noise} µm alone "
            f"gives χ² = {score.chi2:.3g} on {2 * len(score.noise)}, z = {score.z:.1f}"
        )
    shown = DISPLAYED[name]
    factor, unit = shown.factor, "°" if shown.is_angle else " mm"
    smaller = min((s for s in (score.measured_std, score.predicted_std) if s > 0), default=0.0) * factor
    digits = max(2, min(6, 1 - math.floor(math.log10(max(smaller, 1e-6)))))
    pairs = [
        f"{value * factor:.{digits}f} ± {std * factor:.{digits}f}{unit}"
        for value, std in ((score.measured, score.measured_std), (score.predicted, score.predicted_std))
    ]
    return f"{NAMES[name]} {pairs[0]} measured against {pairs[1]} predicted, z = {score.z:.1f}"


def measured_intervals(m: SteadyMeasurement) -> dict[str, Any]:
    """Return the measured values with their uncertainties, by quantity."""
    return {
        "theta3": m.theta_rad[0],
        "theta4": m.theta_rad[1],
        "amplitude_x": m.amplitude_x_m,
        "amplitude_y": m.amplitude_y_m,
        "amplitude": m.amplitude_m,
    }


def finite(value: float) -> float | None:
    """Return a number that JSON can represent, else None."""
    return float(value) if math.isfinite(value) else None
