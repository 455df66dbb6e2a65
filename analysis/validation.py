"""Measured steady states against the model at the validation points: z-scores, verdicts, reasons.

A z-score is the difference over the standard deviation of the difference; that holds the measurement's statistics,
what was still to come, laser gain and encoder zero, and the identified parameters' covariance, the axis angle's and the
speed's. Where the model says "no vibration" (Type I) an amplitude cannot be below it: there the order-1 amplitudes
are held against their noise, as |X|²/σ², whose probability is turned into the |z| of the same probability.
Derivation and the choice of the threshold: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import ndtri_exp

from analysis.errors import NoStableState, NotEnoughData
from analysis.prediction import QUANTITIES, Prediction, predict_point
from analysis.steady_state import SteadyMeasurement, measure
from daq.signals.run import Run, point_of
from rig_configs import IdentifiedParameters, Rig

Z_LIMIT = 4.0
_NAMES = {
    "theta3": "θ3",
    "theta4": "θ4",
    "amplitude_x": "x amplitude",
    "amplitude_y": "y amplitude",
    "amplitude": "rms amplitude",
}
_JSON_KEYS = {
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
        z: (measured − predicted) / √(measured_std² + predicted_std²), or for an amplitude where none is predicted the
            |z| of the same probability as noise.
        measured, measured_std, predicted, predicted_std: what was compared.
        noise: of an amplitude where none is predicted: standard deviations of the real or imaginary part, one for x, y
            or both; empty for a difference.
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

    def to_json(self, key: tuple[str, float]) -> dict[str, Any]:
        """Plain values in the unit of a key (name with unit, factor); what is not known is None."""
        unit, factor = key[0].rpartition("_")[2], key[1]
        numbers = {
            f"measured_{unit}": self.measured * factor, f"measured_std_{unit}": self.measured_std * factor,
            f"predicted_{unit}": self.predicted * factor, f"predicted_std_{unit}": self.predicted_std * factor,
        }  # fmt: skip
        found: dict[str, Any] = {"statistic": "noise" if self.noise else "difference"}
        found |= {name: _finite(value) for name, value in numbers.items()}
        if self.noise:
            found |= {
                f"noise_{unit}": [_finite(s * factor) for s in self.noise],
                "chi2": _finite(self.chi2), "dof": 2 * len(self.noise), "p": self.p,
            }  # fmt: skip
        return found | {"z": _finite(self.z)}


@dataclass(frozen=True)
class PointResult:
    """One point's comparison.

    Attributes:
        name, expected: the point and the rig file's expectation for it (None: the file has no such point).
        state: measured "I", "II", "III", "slipping" or "not settled".
        measurement, prediction: None when there was nothing to measure, or no stable state to predict.
        scores: by quantity (QUANTITIES); empty when nothing could be compared.
        verdict: "pass", "fail", "not settled", "not locked" or "not enough data".
        why: the verdict's reason in one sentence.
        source: the run's log.
    """

    name: str
    expected: str | None
    state: str
    measurement: SteadyMeasurement | None
    prediction: Prediction | None
    scores: Mapping[str, Score]
    verdict: str
    why: str
    source: str

    @property
    def z_scores(self) -> dict[str, float]:
        """z by quantity."""
        return {name: score.z for name, score in self.scores.items()}

    def to_json(self) -> dict[str, Any]:
        """Plain values, units in the names; what is not known is None."""
        measured, measured_std = _measured_json(self.measurement)
        predicted, predicted_std = _predicted_json(self.prediction)
        return {
            "state": self.state,
            "measured": measured,
            "predicted": predicted,
            "measured_std": measured_std,
            "predicted_std": predicted_std,
            "z_scores": {k: _finite(v) for k, v in self.z_scores.items()},
            "verdict": self.verdict,
            "why": self.why,
            "scores": {name: score.to_json(_JSON_KEYS[name]) for name, score in self.scores.items()},
            "to_come": None if self.measurement is None else self.measurement.to_come.to_json(),
        }


@dataclass(frozen=True)
class Validation:
    """All points that were compared, by name."""

    points: Mapping[str, PointResult] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether there is a point and every point passed."""
        return bool(self.points) and all(p.verdict == "pass" for p in self.points.values())

    def to_json(self) -> dict[str, Any]:
        """{"points": {name: …}}, ready for json.dumps."""
        return {"points": {name: point.to_json() for name, point in self.points.items()}}


def validate(
    runs: Sequence[Run],
    rig: Rig,
    identified: IdentifiedParameters,
    axis_angle_deg: tuple[float, float] | None = None,
) -> Validation:
    """Compare every run at a point with the model; other runs are left alone.

    Args:
        runs: recorded tests, any order; a point recorded twice appears as "A" and "A (2)".
        rig: physical part, calibration uncertainties, points with the expected states.
        identified: parameters with covariance.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees; None
            for the identified one, 0 ± 3° where no test has shown it.
    Source: docs/theory/validation.md.
    """
    results: dict[str, PointResult] = {}
    for run in sorted((r for r in runs if point_of(r.test)), key=lambda r: (r.test, r.start_s)):
        name = point_of(run.test)
        taken = sum(1 for key in results if key == name or key.startswith(f"{name} ("))
        results[f"{name} ({taken + 1})" if taken else name] = validate_point(run, rig, identified, axis_angle_deg)
    return Validation(results)


def validate_point(
    run: Run, rig: Rig, identified: IdentifiedParameters, axis_angle_deg: tuple[float, float] | None = None
) -> PointResult:
    """Compare one run with the model; arguments as in `validate`. Never raises for what a log may hold."""
    name = point_of(run.test)
    point = rig.points.get(name)
    expected = point.expected if point else None
    try:
        measured = measure(run, rig)
    except NotEnoughData as error:
        return PointResult(name, expected, "not settled", None, None, {}, "not enough data", f"{error}", run.source)
    prediction, trouble = _predict(rig, identified, measured, axis_angle_deg)
    scores = _scores(measured, prediction) if prediction and measured.state in ("I", "II", "III") else {}
    verdict, why = _judge(measured, prediction, trouble, expected, scores)
    return PointResult(name, expected, measured.state, measured, prediction, scores, verdict, why, run.source)


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


def _predict(
    rig: Rig, identified: IdentifiedParameters, measured: SteadyMeasurement, axis_angle_deg: tuple[float, float] | None
) -> tuple[Prediction | None, str]:
    speed = measured.speed_rad_s
    near = [theta.value for theta in measured.theta_rad]
    try:
        return predict_point(rig, identified, speed.value, axis_angle_deg, speed_std_rad_s=speed.std, near_rad=near), ""
    except NoStableState as error:
        return None, str(error)


def _scores(measured: SteadyMeasurement, prediction: Prediction) -> dict[str, Score]:
    values = _values(measured)
    std = prediction.std
    scores = {}
    for j, name in enumerate(QUANTITIES):
        value, model = values[name].value, float(prediction.values[j])
        difference = value - model
        if j < 2:
            difference = (difference + math.pi) % (2 * math.pi) - math.pi
        z = float(difference / math.hypot(values[name].std, std[j]))
        scores[name] = Score(z, value, values[name].std, model, float(std[j]))
    if prediction.state.type == "I":
        scores |= _noise_scores(measured)
    return scores


def _noise_scores(measured: SteadyMeasurement) -> dict[str, Score]:
    """Of amplitudes where none is predicted: held against noise, what is still to come of them included."""
    noise_x, noise_y = measured.noise_x_m, measured.noise_y_m
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
        scores[name] = Score(balanced_z(amplitudes, noise), value, std, 0.0, 0.0, tuple(noise), chi2, p)
    return scores


def _judge(
    measured: SteadyMeasurement,
    prediction: Prediction | None,
    trouble: str,
    expected: str | None,
    scores: Mapping[str, Score],
) -> tuple[str, str]:
    """Verdict and reason."""
    if measured.state == "slipping" and measured.locked:
        if expected == "slipping":
            return "pass", f"slipping as expected: {measured.settling.why}"
        model = f"the model has a stable state {prediction.state.type} here" if prediction else trouble
        return "fail", f"{measured.settling.why}; {model}"
    if not measured.locked:
        a, b = np.degrees(measured.locked_rad)
        return "not locked", (f"before release the pendulums stood at {a:.1f}° and {b:.1f}°, not locked at 0° and 180°")
    if measured.state == "not settled":
        return "not settled", measured.settling.why
    if prediction is None:
        return "fail", f"measured state {measured.state}, but {trouble}"
    return _compare(measured, prediction, expected, scores)


def _compare(
    measured: SteadyMeasurement, prediction: Prediction, expected: str | None, scores: Mapping[str, Score]
) -> tuple[str, str]:
    """Verdict and reason of a settled state."""
    if measured.state != prediction.state.type:
        return "fail", f"measured state {measured.state}, but the model's stable state is {prediction.state.type}"
    if expected is not None and measured.state != expected:
        return "fail", f"measured and model state {measured.state}, but the rig file expects {expected}"
    off = sorted((n for n, s in scores.items() if not abs(s.z) <= Z_LIMIT), key=lambda n: -abs(scores[n].z))
    if off:
        return "fail", "; ".join(_sentence(n, scores[n]) for n in off) + _moved_on(measured)
    largest = max(scores, key=lambda n: abs(scores[n].z))
    return "pass", (
        f"state {measured.state}, all within {Z_LIMIT:g} standard deviations; "
        f"largest: {_NAMES[largest]}, z = {scores[largest].z:.1f}{_moved_on(measured)}"
    )


def _moved_on(measured: SteadyMeasurement) -> str:
    """How much was extrapolated, where it matters."""
    sentence = measured.to_come.sentence
    return f"; {sentence}" if sentence else ""


def _sentence(name: str, score: Score) -> str:
    """One quantity that is off, in words, with both uncertainties."""
    if score.noise:
        noise = " and ".join(f"{s * 1e6:.2g}" for s in score.noise)
        return (
            f"{_NAMES[name]} {score.measured * 1e6:.2f} µm measured where none is predicted, noise of {noise} µm alone "
            f"gives χ² = {score.chi2:.3g} on {2 * len(score.noise)}, z = {score.z:.1f}"
        )
    factor, unit = (180 / math.pi, "°") if name.startswith("theta") else (1e3, " mm")
    smaller = min(s for s in (score.measured_std, score.predicted_std, math.inf) if s > 0) * factor
    digits = max(2, min(6, 1 - math.floor(math.log10(max(smaller, 1e-6)))))
    pairs = [
        f"{value * factor:.{digits}f} ± {std * factor:.{digits}f}{unit}"
        for value, std in ((score.measured, score.measured_std), (score.predicted, score.predicted_std))
    ]
    return f"{_NAMES[name]} {pairs[0]} measured against {pairs[1]} predicted, z = {score.z:.1f}"


def _values(m: SteadyMeasurement) -> dict[str, Any]:
    return {
        "theta3": m.theta_rad[0],
        "theta4": m.theta_rad[1],
        "amplitude_x": m.amplitude_x_m,
        "amplitude_y": m.amplitude_y_m,
        "amplitude": m.amplitude_m,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _measured_json(m: SteadyMeasurement | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    keys = [*_JSON_KEYS.values(), ("speed_rpm", 30 / math.pi)]
    if m is None:
        return {key: None for key, _ in keys}, {key: None for key, _ in keys}
    values = [*(_values(m)[name] for name in _JSON_KEYS), m.speed_rad_s]
    pairs = list(zip(keys, values, strict=True))
    return {k: _finite(v.value * f) for (k, f), v in pairs}, {k: _finite(v.std * f) for (k, f), v in pairs}


def _predicted_json(p: Prediction | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    if p is None:
        return _measured_json(None)
    order = [QUANTITIES.index(name) for name in _JSON_KEYS]
    values = {key: _finite(p.values[j] * f) for j, (key, f) in zip(order, _JSON_KEYS.values(), strict=True)}
    stds = {key: _finite(p.std[j] * f) for j, (key, f) in zip(order, _JSON_KEYS.values(), strict=True)}
    return values | {"speed_rpm": p.speed_rad_s * 30 / math.pi}, stds | {"speed_rpm": 0.0}
