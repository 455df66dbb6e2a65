"""Comparison of one point with the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from analysis.prediction import QUANTITIES, Prediction
from analysis.scores import DISPLAYED, Score, finite, measured_intervals
from analysis.steady_state import SteadyMeasurement
from rig_basics.tabular import Column, Tabular
from rig_basics.units import TO_RPM


@dataclass(frozen=True)
class PointResult(Tabular):
    """Comparison of one point.

    Attributes:
        name, expected: name of the point and expected state of the rig file (None: the file has no such point).
        state: measured "I", "II", "III", "slipping" or "not settled".
        measurement, prediction: None without a measurable interval or a stable state of the model.
        scores: scores by quantity (QUANTITIES); empty if nothing could be compared.
        verdict: "pass", "fail", "not settled", "not locked" or "not enough data".
        why: reason of the verdict in one sentence.
        source: log of the run.
        because: known reason, part of `why`; "" without one.
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
    because: str = ""

    @property
    def heading(self) -> str:
        """Verdict with its reason."""
        return f"PointResult {self.name}: {self.verdict}; {self.why}"

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks on the signals."""
        return () if self.measurement is None else self.measurement.remarks

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity, in the displayed units; unknown values are NaN."""
        found: dict[str, list[object]] = {"quantity": [each.key for each in DISPLAYED.values()]}
        for side, (values, _) in (
            ("measured", _measured_json(self.measurement)),
            ("predicted", _predicted_json(self.prediction)),
        ):
            found[side] = [math.nan if (value := values[each.key]) is None else value for each in DISPLAYED.values()]
        for column, of in (("difference", "error"), ("uncertainty", "u_validation")):
            found[column] = [getattr(self.scores.get(n), of, math.nan) * each.factor for n, each in DISPLAYED.items()]
        return found | {"z": [self.z_scores.get(name, math.nan) for name in DISPLAYED]}

    @property
    def z_scores(self) -> dict[str, float]:
        """z by quantity."""
        return {name: score.z for name, score in self.scores.items()}

    def to_json(self) -> dict[str, Any]:
        """Return plain values with units in the names; unknown values are None."""
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
            "scores": {name: score.to_json(DISPLAYED[name]) for name, score in self.scores.items()},
            "to_come": None if self.measurement is None else self.measurement.to_come.to_json(),
        }


def _measured_json(m: SteadyMeasurement | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    keys = [*((each.key, each.factor) for each in DISPLAYED.values()), ("speed_rpm", TO_RPM)]
    if m is None:
        return {key: None for key, _ in keys}, {key: None for key, _ in keys}
    values = [*(measured_intervals(m)[name] for name in DISPLAYED), m.speed_rad_s]
    pairs = list(zip(keys, values, strict=True))
    return {k: finite(v.value * f) for (k, f), v in pairs}, {k: finite(v.std * f) for (k, f), v in pairs}


def _predicted_json(p: Prediction | None) -> tuple[dict[str, float | None], dict[str, float | None]]:
    if p is None:
        return _measured_json(None)
    order = [QUANTITIES.index(name) for name in DISPLAYED]
    values = {key: finite(p.values[j] * f) for j, (key, f, _) in zip(order, DISPLAYED.values(), strict=True)}
    stds = {key: finite(p.std[j] * f) for j, (key, f, _) in zip(order, DISPLAYED.values(), strict=True)}
    return values | {"speed_rpm": p.speed_rad_s * TO_RPM}, stds | {"speed_rpm": 0.0}
