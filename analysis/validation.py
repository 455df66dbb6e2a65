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
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from analysis.agreement import Agreement
from analysis.differences import RELEASE, Compared, Rows
from analysis.errors import NoStableState, NotEnoughData
from analysis.explanations import Explanations
from analysis.noticed import Noticed
from analysis.overall import overall
from analysis.prediction import QUANTITIES, Prediction, predict_point
from analysis.scores import JSON_KEYS, NAMES, Z_LIMIT, Score, finite, measured_intervals, scores_of, sentence
from analysis.steady_state import SteadyMeasurement, measure
from daq.signals.run import Run, point_of
from rig_configs import IdentifiedParameters, Rig


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
            "z_scores": {k: finite(v) for k, v in self.z_scores.items()},
            "verdict": self.verdict,
            "why": self.why,
            "scores": {name: score.to_json(JSON_KEYS[name]) for name, score in self.scores.items()},
            "to_come": None if self.measurement is None else self.measurement.to_come.to_json(),
        }


@dataclass(frozen=True)
class Validation:
    """All points that were compared.

    Attributes:
        points: by name.
        agreement: of all points together with the model; None where no point could be compared.
        explanations: what would explain the differences; None where they agree.
        noticed: cause, in words → the smallest size that the most sensitive point alone would notice, and that point.
    """

    points: Mapping[str, PointResult] = field(default_factory=dict)
    agreement: Agreement | None = None
    explanations: Explanations | None = None
    noticed: Sequence[Noticed] = ()

    @property
    def passed(self) -> bool:
        """Whether there is a point, every point passed, and all of them together agree with the model."""
        each = bool(self.points) and all(p.verdict == "pass" for p in self.points.values())
        return each and (self.agreement is None or self.agreement.passed)

    def to_json(self) -> dict[str, Any]:
        """Plain values, ready for json.dumps: "points" by name, and what all of them say together."""
        return {
            "points": {name: point.to_json() for name, point in self.points.items()},
            "agreement": None if self.agreement is None else self.agreement.to_json(),
            "explanations": None if self.explanations is None else self.explanations.to_json(),
            "noticed": [one.to_json() for one in self.noticed],
        }


def validate(
    runs: Sequence[Run],
    rig: Rig,
    identified: IdentifiedParameters,
    axis_angle_deg: tuple[float, float] | None = None,
    releases: Sequence[Rows] = (),
) -> Validation:
    """Compare every run at a point with the model; other runs are left alone.

    Args:
        runs: recorded tests, any order; a point recorded twice appears as "A" and "A (2)".
        rig: physical part, calibration uncertainties, points with the expected states.
        identified: parameters with covariance.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees; None
            for the identified one, 0 ± 3° where no test has shown it.
        releases: what happened right after releases at the points, held against the same parameters.
    Source: docs/theory/validation.md.
    """
    identified = identified.completed(rig.physics)  # what was not identified, or set, may be wrong as well
    results: dict[str, PointResult] = {}
    for run in sorted((r for r in runs if point_of(r.test)), key=lambda r: (r.test, r.start_s)):
        name = point_of(run.test)
        taken = sum(1 for key in results if key == name or key.startswith(f"{name} ("))
        results[f"{name} ({taken + 1})" if taken else name] = validate_point(run, rig, identified, axis_angle_deg)
    settled = {
        name: point
        for name, point in results.items()
        if point.scores and point.prediction is not None and point.state == point.prediction.state.type
    }
    found = overall(
        [Compared(n, p.measurement, p.prediction) for n, p in settled.items() if p.measurement and p.prediction],
        rig, identified, axis_angle_deg, [each for each in releases if each.point in results],
    )  # fmt: skip
    if found is None:
        return Validation(results)
    for group in found.agreement.failing_points:
        name = group.removesuffix(f" {RELEASE}")
        if results[name].verdict == "pass":
            statistic = found.agreement.points[group]
            which = "its quantities together" if name == group else "what happened right after the release"
            why = f"{which}: χ² {statistic.chi2:.3g} on {statistic.dof}, p = {statistic.p:.1g}"
            results[name] = replace(results[name], verdict="fail", why=why)
    validation = Validation(results, found.agreement, found.explanations, found.noticed)
    return (
        validation
        if found.explanations is not None or validation.passed
        else replace(validation, explanations=found.explain())
    )


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
    if prediction is not None and prediction.held is not None:
        measured = _held(run, rig, measured, prediction)
    scores = scores_of(measured, prediction, rig) if prediction and measured.state in ("I", "II", "III") else {}
    verdict, why = _judge(measured, prediction, trouble, expected, scores)
    return PointResult(name, expected, measured.state, measured, prediction, scores, verdict, why, run.source)


def _held(run: Run, rig: Rig, measured: SteadyMeasurement, prediction: Prediction) -> SteadyMeasurement:
    """The measurement of pendulums that known dry friction holds, or lets creep, beside the predicted angles."""
    held = prediction.held
    if held is None or not np.any(held.half_width_rad > 0):
        return measured
    if measured.state == "not settled":
        measured = measure(run, rig, float(np.max(held.outer_rad)))
    off = np.array([theta.value for theta in measured.theta_rad]) - prediction.values[:2]
    inside = bool(np.all(np.abs((off + math.pi) % (2 * math.pi) - math.pi) <= held.outer_rad))
    settled = measured.state not in ("not settled", "slipping")
    return replace(measured, state=prediction.state.type) if inside and settled else measured


def _predict(
    rig: Rig, identified: IdentifiedParameters, measured: SteadyMeasurement, axis_angle_deg: tuple[float, float] | None
) -> tuple[Prediction | None, str]:
    speed = measured.speed_rad_s
    near = [theta.value for theta in measured.theta_rad]
    try:
        return predict_point(rig, identified, speed.value, axis_angle_deg, speed_std_rad_s=speed.std, near_rad=near), ""
    except NoStableState as error:
        return None, str(error)


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
        dry = prediction is not None and prediction.held is not None
        rubs = "; the dry friction that was identified makes the approach a creep" if dry else ""
        return "not settled", measured.settling.why + rubs
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
        return "fail", "; ".join(sentence(n, scores[n]) for n in off) + _moved_on(measured)
    largest = max(scores, key=lambda n: abs(scores[n].z))
    return "pass", (
        f"state {measured.state}, all within {Z_LIMIT:g} standard deviations; "
        f"largest: {NAMES[largest]}, z = {scores[largest].z:.1f}{_moved_on(measured)}"
    )


def _moved_on(measured: SteadyMeasurement) -> str:
    """How much was extrapolated, where it matters, and that friction lets it creep."""
    if measured.creeps:
        left = math.degrees(measured.settling.remaining_rad)
        return f"; held and shaken loose by dry friction it creeps, by up to {left:.2g}° more"
    moved = measured.to_come.sentence
    return f"; {moved}" if moved else ""


def _measured_json(m: SteadyMeasurement | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    keys = [*JSON_KEYS.values(), ("speed_rpm", 30 / math.pi)]
    if m is None:
        return {key: None for key, _ in keys}, {key: None for key, _ in keys}
    values = [*(measured_intervals(m)[name] for name in JSON_KEYS), m.speed_rad_s]
    pairs = list(zip(keys, values, strict=True))
    return {k: finite(v.value * f) for (k, f), v in pairs}, {k: finite(v.std * f) for (k, f), v in pairs}


def _predicted_json(p: Prediction | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    if p is None:
        return _measured_json(None)
    order = [QUANTITIES.index(name) for name in JSON_KEYS]
    values = {key: finite(p.values[j] * f) for j, (key, f) in zip(order, JSON_KEYS.values(), strict=True)}
    stds = {key: finite(p.std[j] * f) for j, (key, f) in zip(order, JSON_KEYS.values(), strict=True)}
    return values | {"speed_rpm": p.speed_rad_s * 30 / math.pi}, stds | {"speed_rpm": 0.0}
