"""Measured steady states against the model at the validation points: z-scores, verdicts, reasons.

A z-score is the difference over the standard deviation of the difference; that holds the measurement's statistics,
residual drift, laser gain and encoder zero, and the identified parameters' covariance, the axis angle's and the
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
from daq.signals import Run
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
class PointResult:
    """One point's comparison.

    Attributes:
        name, expected: the point and the rig file's expectation for it (None: the file has no such point).
        state: measured "I", "II", "III", "slipping" or "not settled".
        measurement, prediction: None when there was nothing to measure, or no stable state to predict.
        z_scores: by quantity (QUANTITIES); empty when nothing could be compared.
        verdict: "pass", "fail", "not settled", "not locked" or "not enough data".
        why: the verdict's reason in one sentence.
        source: the run's log.
    """

    name: str
    expected: str | None
    state: str
    measurement: SteadyMeasurement | None
    prediction: Prediction | None
    z_scores: Mapping[str, float]
    verdict: str
    why: str
    source: str

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
    axis_angle_deg: tuple[float, float] = (0.0, 0.0),
) -> Validation:
    """Compare every "point-NAME" run with the model; other runs are left alone.

    Args:
        runs: recorded tests, any order; a point recorded twice appears as "A" and "A (2)".
        rig: physical part, calibration uncertainties, points with the expected states.
        identified: parameters with covariance.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees.
    Source: docs/theory/validation.md.
    """
    results: dict[str, PointResult] = {}
    for run in sorted((r for r in runs if r.test.startswith("point-")), key=lambda r: (r.test, r.start_s)):
        name = run.test.removeprefix("point-")
        taken = sum(1 for key in results if key == name or key.startswith(f"{name} ("))
        results[f"{name} ({taken + 1})" if taken else name] = validate_point(run, rig, identified, axis_angle_deg)
    return Validation(results)


def validate_point(
    run: Run, rig: Rig, identified: IdentifiedParameters, axis_angle_deg: tuple[float, float] = (0.0, 0.0)
) -> PointResult:
    """Compare one run with the model; arguments as in `validate`. Never raises for what a log may hold."""
    name = run.test.removeprefix("point-")
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
    power = sum((a / s) ** 2 for a, s in zip(amplitudes_m, stds_m, strict=True))
    log_p = -power / 2 + (math.log1p(power / 2) if len(amplitudes_m) == 2 else 0.0)
    return float(-ndtri_exp(log_p - math.log(2)))


def _predict(
    rig: Rig, identified: IdentifiedParameters, measured: SteadyMeasurement, axis_angle_deg: tuple[float, float]
) -> tuple[Prediction | None, str]:
    speed = measured.speed_rad_s
    near = [theta.value for theta in measured.theta_rad]
    try:
        return predict_point(rig, identified, speed.value, axis_angle_deg, speed_std_rad_s=speed.std, near_rad=near), ""
    except NoStableState as error:
        return None, str(error)


def _scores(measured: SteadyMeasurement, prediction: Prediction) -> dict[str, float]:
    values = _values(measured)
    std = prediction.std
    scores = {}
    for j, name in enumerate(QUANTITIES):
        difference = values[name].value - prediction.values[j]
        if j < 2:
            difference = (difference + math.pi) % (2 * math.pi) - math.pi
        scores[name] = float(difference / math.hypot(values[name].std, std[j]))
    if prediction.state.type == "I":
        off = measured.settling.remaining_rad
        off = off if math.isfinite(off) else 0.0
        stds = [
            math.hypot(noise, gain * off)
            for noise, gain in zip((measured.noise_x_m, measured.noise_y_m), prediction.residual_m_per_rad, strict=True)
        ]
        amplitudes = [abs(measured.x_m), abs(measured.y_m)]
        scores["amplitude_x"] = balanced_z(amplitudes[:1], stds[:1])
        scores["amplitude_y"] = balanced_z(amplitudes[1:], stds[1:])
        scores["amplitude"] = balanced_z(amplitudes, stds)
    return scores


def _judge(
    measured: SteadyMeasurement,
    prediction: Prediction | None,
    trouble: str,
    expected: str | None,
    scores: Mapping[str, float],
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
    measured: SteadyMeasurement, prediction: Prediction, expected: str | None, scores: Mapping[str, float]
) -> tuple[str, str]:
    """Verdict and reason of a settled state."""
    if measured.state != prediction.state.type:
        return "fail", f"measured state {measured.state}, but the model's stable state is {prediction.state.type}"
    if expected is not None and measured.state != expected:
        return "fail", f"measured and model state {measured.state}, but the rig file expects {expected}"
    off = sorted((n for n, z in scores.items() if not abs(z) <= Z_LIMIT), key=lambda n: -abs(scores[n]))
    if off:
        return "fail", "; ".join(_sentence(n, measured, prediction, scores[n]) for n in off)
    largest = max(scores, key=lambda n: abs(scores[n]))
    return "pass", (
        f"state {measured.state}, all within {Z_LIMIT:g} standard deviations; "
        f"largest: {_NAMES[largest]}, z = {scores[largest]:.1f}"
    )


def _sentence(name: str, measured: SteadyMeasurement, prediction: Prediction, z: float) -> str:
    """One quantity that is off, in words."""
    value = _values(measured)[name].value
    j = QUANTITIES.index(name)
    model, std = prediction.values[j], prediction.std[j]
    if name.startswith("theta"):
        return (
            f"{_NAMES[name]} {math.degrees(value):.2f}° measured against {math.degrees(model):.2f} ± "
            f"{math.degrees(std):.2f}° predicted, z = {z:.1f}"
        )
    if prediction.state.type == "I":
        return f"{_NAMES[name]} {value * 1e6:.2f} µm measured where none is predicted, noise alone gives z = {z:.1f}"
    digits = max(2, min(4, 1 - math.floor(math.log10(max(std * 1e3, 1e-4)))))
    return (
        f"{_NAMES[name]} {value * 1e3:.{digits}f} mm measured against {model * 1e3:.{digits}f} ± "
        f"{std * 1e3:.{digits}f} mm predicted, z = {z:.1f}"
    )


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
