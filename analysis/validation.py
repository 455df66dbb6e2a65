"""Measured steady states against the model at the validation points: z-scores, verdicts, reasons.

A z-score is the difference over its standard deviation. The deviation contains the measurement's statistics, the
remaining approach, laser gain and encoder zero, the covariance of the identified parameters, the axis angle and the
speed. Where the model predicts no vibration (Type I) an amplitude cannot be smaller than predicted. There the order-1
amplitudes are compared with their noise as |X|²/σ², whose probability is converted to the |z| of the same probability.
Derivation and choice of the threshold: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.agreement import Agreement
from analysis.bent_shaft import blamed_on_bow
from analysis.differences import RELEASE, PointComparison, Rows
from analysis.errors import NoStableState, NotEnoughData
from analysis.explanations import Explanations
from analysis.noticed import DetectableSizes
from analysis.overall import overall
from analysis.prediction import Prediction, predict_point
from analysis.results import PointResult
from analysis.scores import NAMES, Z_LIMIT, Score, scores_of, sentence
from analysis.start_ups import START_UPS, StartUps, start_ups
from analysis.steady_state import SteadyMeasurement, locked_radius_m, measure
from analysis.term_errors import effects
from daq.guided_test_kinds import point_of
from daq.signals.run import Run
from daq.signals.speed_agreement import SPEED_TOLERANCE
from daq.signals.threads import on_one_thread
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.units import RPM
from rig_configs import IdentifiedParameters, Rig
from rig_configs.drag import Reading, read_as
from rig_configs.known import assumed_remarks
from rig_configs.parameters_file import filled_remarks

_SPEED_STDS = 3.0  # of the measured speed, beyond the tolerance of the requested one
_READINGS: Mapping[Reading, str] = {
    "drag": "by the releases, what a spin-down shows to grow with the square of the speed is the drag of the air",
    "contact": "by the releases, what a spin-down shows to grow with the square of the speed is dry friction with the "
    "contact force",
}


@dataclass(frozen=True)
class Validation(Tabular):
    """Result of all compared points.

    Attributes:
        points: result of each point by name.
        agreement: agreement of all points together with the model; None if no point could be compared.
        explanations: explanations of the differences; None if the points agree with the model.
        noticed: smallest size of each cause that the most sensitive point alone would detect, with that point.
        start_ups: repeated start-ups by their requested speed.
        of_releases: sentences on effects in the releases that no test has identified.
        suspension: sentences on the effect of identified terms of the suspension at the points.
        reading: interpretation by the releases of a torque that grows with the square of the speed; "" if a test
            decided it.
        filled: name of a parameter that is not identified → the rig file's value in its place, and its uncertainty.
        assumed: numbers of the rig file whose standard uncertainty is not stated there, as in `KnownNumbers`.
    """

    points: Mapping[str, PointResult] = field(default_factory=dict[str, PointResult])
    agreement: Agreement | None = None
    explanations: Explanations | None = None
    noticed: Sequence[DetectableSizes] = ()
    start_ups: Sequence[StartUps] = ()
    reading: Reading = ""
    of_releases: Sequence[str] = ()
    suspension: Sequence[str] = ()
    filled: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    assumed: Sequence[str] = ()

    @property
    def heading(self) -> str:
        """Result and number of points that pass."""
        passed = sum(point.verdict == "pass" for point in self.points.values())
        verdict = "passed" if self.passed else "not passed"
        return f"Validation: {verdict}, {passed} of {number_of(len(self.points), 'point')} pass"

    @property
    def remarks(self) -> Sequence[str]:
        """Reasons and warnings."""
        return [*self.reasons, *self.warnings]

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity of each point, in the units of `PointResult`, with the point's verdict."""
        names = "quantity", "measured", "predicted", "difference", "uncertainty", "z"
        tables = {name: point.columns() for name, point in self.points.items()}
        found = {column: [value for table in tables.values() for value in table[column]] for column in names}
        rows = [(name, self.points[name].verdict) for name, table in tables.items() for _ in table["quantity"]]
        return {"point": [name for name, _ in rows], **found, "verdict": [verdict for _, verdict in rows]}

    @property
    def reasons(self) -> list[str]:
        """Known reasons of points that do not pass, a sentence each."""
        return [f"{name}: {point.because}" for name, point in self.points.items() if point.because]

    @property
    def warnings(self) -> list[str]:
        """Messages on values that no test gave, on drag, releases and suspension, and on the signals by log name."""
        return [
            *filled_remarks(self.filled),
            *assumed_remarks(self.assumed),
            *([_READINGS[self.reading]] if self.reading else []),
            *self.of_releases,
            *self.suspension,
            *self._remarks,
        ]

    @property
    def _remarks(self) -> list[str]:
        return [
            f"{Path(point.source).name}: {remark}"
            for point in self.points.values()
            if point.measurement is not None
            for remark in point.measurement.remarks
        ]

    @property
    def passed(self) -> bool:
        """Whether at least one point or start-up exists, each passed, and all points together agree with the model."""
        parts = [p.verdict == "pass" for p in self.points.values()] + [series.passed for series in self.start_ups]
        return bool(parts) and all(parts) and (self.agreement is None or self.agreement.passed)

    def to_json(self) -> dict[str, Any]:
        """Return plain values, ready for json.dumps: "points" by name, and the results of all points together."""
        return {
            "points": {name: point.to_json() for name, point in self.points.items()},
            "agreement": None if self.agreement is None else self.agreement.to_json(),
            "reasons": self.reasons,
            "explanations": None if self.explanations is None else self.explanations.to_json(),
            "noticed": [one.to_json() for one in self.noticed],
            "start_ups": [series.to_json() for series in self.start_ups],
            "filled": {name: {"value": value, "std": std} for name, (value, std) in self.filled.items()},
        }


@on_one_thread
def validate(
    runs: Sequence[Run],
    rig: Rig,
    identified: IdentifiedParameters,
    axis_angle_deg: tuple[float, float] | None = None,
    releases: Sequence[Rows] = (),
    exact: Collection[str] = (),
) -> Validation:
    """Compare every run at a point, and every repeated start-up, with the model; other runs are ignored.

    Args:
        runs: recorded tests in any order; a point recorded twice appears as "A" and "A (2)".
        rig: rig file with physical part, calibration uncertainties, and points with the expected states.
        identified: parameters with covariance.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees; None
            for the identified angle, or the mounting angle of the rig file if no test identified it.
        releases: rows of the motions right after releases at the points, and of run-ups that were not used for the
            identification, calculated with the same parameters.
        exact: names of parameters that were set, whose values are those of the rig. Other parameters that are missing
            have the rig's design values with their uncertainty, and the result names them.
    Source: docs/theory/validation.md.
    """
    assumed = rig.known.assumed
    filled = {name: value for name, value in identified.missing(rig.physics, exact).items() if name not in exact}
    identified = identified.completed(rig.physics, exact)
    readings: list[Reading] = [each.reading for each in releases if each.reading]
    reading: Reading = readings[0] if readings else ""
    identified = replace(identified, provenance=read_as(identified.provenance, reading))
    remarks = [each.remark for each in releases if each.remark]
    results: dict[str, PointResult] = {}
    recorded = Counter[str]()  # runs of each point so far
    for run in sorted((r for r in runs if point_of(r.test)), key=lambda r: (r.test, r.start_s)):
        name = point_of(run.test)
        recorded[name] += 1
        results[f"{name} ({recorded[name]})" if recorded[name] > 1 else name] = validate_point(
            run, rig, identified, axis_angle_deg
        )
    settled = {
        name: point
        for name, point in results.items()
        if point.scores and point.prediction is not None and point.state == point.prediction.state.type
    }
    found = overall(
        [PointComparison(n, p.measurement, p.prediction) for n, p in settled.items() if p.measurement and p.prediction],
        rig,
        identified,
        axis_angle_deg,
        [each for each in releases if each.point in results or _is_test(each)],
    )
    repeated = _start_ups(runs, rig, identified, axis_angle_deg)
    changed = _suspension(results, identified)
    if found is None:
        return Validation(
            results,
            start_ups=repeated,
            reading=reading,
            of_releases=remarks,
            suspension=changed,
            filled=filled,
            assumed=assumed,
        )
    for group in found.agreement.failing_points:
        name = group.removesuffix(f" {RELEASE}")
        if name in results and results[name].verdict == "pass":
            statistic = found.agreement.points[group]
            which = "its quantities together" if name == group else "what happened right after the release"
            why = f"{which}: χ² {statistic.chi2:.3g} on {statistic.dof}, p = {statistic.p:.1g}"
            results[name] = replace(results[name], verdict="fail", why=why)
    validation = Validation(
        results,
        found.agreement,
        found.explanations,
        found.noticed,
        repeated,
        reading,
        remarks,
        changed,
        filled,
        assumed,
    )
    off = any(p.verdict == "fail" and p.scores for p in results.values())  # a wrong state has no differences
    return validation if validation.explanations or not off else replace(validation, explanations=found.explain())


def _is_test(rows: Rows) -> bool:
    """Whether rows are those of a separate test, as a run-up, and not of a release at a point."""
    return bool(rows.rows) and not rows.rows[0].startswith(RELEASE)


def _suspension(results: Mapping[str, PointResult], identified: IdentifiedParameters) -> list[str]:
    """Return the effect of the suspension's terms at each point, a sentence each."""
    found = {
        name: effects(identified, point.prediction.state, point.prediction.speed_rad_s)
        for name, point in results.items()
        if point.prediction is not None
    }
    return [f"at {name} {text}" for name, text in found.items() if text]


def _start_ups(
    runs: Sequence[Run], rig: Rig, identified: IdentifiedParameters, axis_angle_deg: tuple[float, float] | None
) -> list[StartUps]:
    """Return repeated start-ups by their requested speed, slowest first."""
    series: dict[float, list[Run]] = {}
    for run in sorted((r for r in runs if r.test == START_UPS), key=lambda r: r.start_s):
        series.setdefault(_asked_rpm(run), []).append(run)
    return [
        start_ups(
            speed,
            [validate_point(run, rig, identified, axis_angle_deg) for run in alike],
            [locked_radius_m(run) for run in alike],
        )
        for speed, alike in sorted(series.items())
    ]


def _asked_rpm(run: Run) -> float:
    """Return the requested speed of a start-up's log; 0 if the log has none, as recordings from other programs."""
    try:
        speed = float(run.metadata.get("speed_rpm", 0.0))
    except (TypeError, ValueError):  # usual: a recording of another program
        return 0.0
    return speed if math.isfinite(speed) else 0.0


def validate_point(
    run: Run, rig: Rig, identified: IdentifiedParameters, axis_angle_deg: tuple[float, float] | None = None
) -> PointResult:
    """Compare one run with the model; arguments as in `validate`. Raises no error for any content of a log."""
    name = point_of(run.test)
    point = rig.points.get(name)
    expected = point.expected if point else None
    try:
        measured = measure(run, rig, _bow_m(identified))
    except NotEnoughData as error:
        return PointResult(name, expected, "not settled", None, None, {}, "not enough data", f"{error}", run.source)
    prediction, trouble = _predict(rig, identified, measured, axis_angle_deg)
    if prediction is not None and prediction.held is not None:
        measured = _held(run, rig, identified, measured, prediction)
    if wrong_speed := _wrong_speed(run, measured):  # another steady state than the one that was to be tested
        return PointResult(
            name, expected, measured.state, measured, prediction, {}, "fail", wrong_speed, run.source, wrong_speed
        )
    scores = scores_of(measured, prediction, rig) if prediction and measured.state in ("I", "II", "III") else {}
    verdict, why = _judge(measured, prediction, trouble, expected, scores)
    because = ""
    if verdict == "not settled" or (verdict == "fail" and not _same_as(expected, measured, prediction)):
        state = prediction.state if prediction else None
        because = blamed_on_bow(identified.applied_to(rig.physics), measured.speed_rad_s.value, state)
        why = f"{why}; {because}" if because else why
    return PointResult(name, expected, measured.state, measured, prediction, scores, verdict, why, run.source, because)


def _wrong_speed(run: Run, measured: SteadyMeasurement) -> str:
    """Return how the measured speed contradicts the requested one or the drive's; empty if it does not."""
    if run.speed is not None and not run.speed.agrees:
        return run.speed.words
    asked_rpm, rpm, std_rpm = _asked_rpm(run), measured.speed_rad_s.value / RPM, measured.speed_rad_s.std / RPM
    share, more = SPEED_TOLERANCE
    if not asked_rpm or abs(rpm - asked_rpm) <= share * asked_rpm + more + _SPEED_STDS * std_rpm:
        return ""
    return f"the rotor turned at {rpm:.0f} rpm by the index marks, {asked_rpm:.0f} rpm were requested. Repeat the test"


def _same_as(expected: str | None, measured: SteadyMeasurement, prediction: Prediction | None) -> bool:
    """Whether the measured state is the predicted and the expected one."""
    return prediction is not None and measured.state == prediction.state.type and expected in (None, measured.state)


def _bow_m(identified: IdentifiedParameters) -> complex:
    return identified.slow_roll.bow_m if identified.slow_roll else 0j


def _held(
    run: Run, rig: Rig, identified: IdentifiedParameters, measured: SteadyMeasurement, prediction: Prediction
) -> SteadyMeasurement:
    """Return the measurement of pendulums held or slowed by known dry friction, with the state of the prediction."""
    held = prediction.held
    if held is None or not np.any(held.half_width_rad > 0):
        return measured
    if measured.state == "not settled":
        measured = measure(run, rig, _bow_m(identified), float(np.max(held.outer_rad)))
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
    """Return verdict and reason."""
    if measured.state == "slipping" and measured.locked:
        if expected == "slipping":
            return "pass", f"slipping as expected: {measured.settling.why}"
        model = f"the model has a stable state {prediction.state.type} here" if prediction else trouble
        return "fail", f"{measured.settling.why}; {model}"
    if not measured.locked:
        a, b = np.degrees(measured.locked_rad)
        return "not locked", (f"before release the pendulums stood at {a:.1f}° and {b:.1f}°, not locked at 0° and 180°")
    if measured.state == "not settled":
        return "not settled", measured.settling.why + (_rubbing(prediction) if prediction else "")
    if prediction is None:
        return "fail", f"measured state {measured.state}, but {trouble}"
    return _compare(measured, prediction, expected, scores)


def _compare(
    measured: SteadyMeasurement, prediction: Prediction, expected: str | None, scores: Mapping[str, Score]
) -> tuple[str, str]:
    """Return verdict and reason of a settled state."""
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


def _rubbing(prediction: Prediction) -> str:
    """Explain late settling by known dry friction: creep within the band, or a long stay at the unstable balance."""
    if prediction.held is None:
        return ""
    if np.any(prediction.held.half_width_rad > 0):
        return "; the dry friction that was identified makes the approach a creep"
    return "; the dry friction that was identified lets the pendulums leave their unstable balance late: record longer"


def _moved_on(measured: SteadyMeasurement) -> str:
    """Describe a relevant extrapolation, or a creep due to friction."""
    if measured.creeps:
        left = math.degrees(measured.settling.remaining_rad)
        return f"; dry friction holds and releases it repeatedly, so that it creeps, by up to {left:.2g}° more"
    moved = measured.to_come.sentence
    return f"; {moved}" if moved else ""
