"""Result of all points together: agreement, smallest detectable deviations, and explanations of a failure."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.agreement import Agreement, agreement
from analysis.causes import Cause, causes, torques_of
from analysis.differences import Differences, PointComparison, Rows, differences
from analysis.errors import NoStableState
from analysis.explanations import Explanations, explanations
from analysis.noticed import DetectableSizes, noticed
from analysis.prediction import predict_point
from dynamics.errors import DynamicsError
from rig_configs import IdentifiedParameters, Rig
from rig_configs.drag import Drag
from rig_configs.errors import RigConfigError
from rig_configs.known import CONTACT_FRICTION, DRAG, FRICTION, KEPT_FRICTION, PHYSICAL
from rig_configs.slow_roll import SlowRoll

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Overall:
    """Result of all points together.

    Attributes:
        agreement: agreement with the model.
        explanations: explanations of the differences; None if the points agree with the model.
        noticed: smallest detectable deviation of each cause.
    """

    agreement: Agreement
    explanations: Explanations | None
    noticed: tuple[DetectableSizes, ...]
    _case: _Case

    def explain(self) -> Explanations:
        """Return the explanations of the differences, significant or not."""
        return self._case.explained()


def overall(
    compared: Sequence[PointComparison],
    rig: Rig,
    identified: IdentifiedParameters,
    axis_angle_deg: tuple[float, float] | None = None,
    releases: Sequence[Rows] = (),
) -> Overall | None:
    """Evaluate all points together; None without points and releases.

    Args:
        compared: points whose measured state is the predicted one.
        rig, identified, axis_angle_deg: inputs of the predictions.
        releases: rows of the motions right after releases, with the same inputs.
    """
    releases = tuple(each for each in releases if each.rows)
    if not compared and not releases:
        return None
    if axis_angle_deg is not None:
        identified = replace(identified, axis_angle_deg=axis_angle_deg)
    found = differences(compared, rig, identified, releases)
    suspects = causes(found, rig, identified)
    case = _Case(tuple(compared), rig, identified, found, suspects, releases)
    whole = agreement(found, suspects)
    return Overall(whole, None if whole.passed else case.explained(), noticed(found, suspects), case)


def _as_kept(torques: Mapping[str, float]) -> dict[str, Any]:
    """Return a trial friction or drag by its key in the provenance of an identification."""
    if not set(torques).isdisjoint(DRAG):
        return Drag(np.array([max(0.0, torques.get(name, 0.0)) for name in DRAG]), np.zeros((2, 2))).table
    values = [max(0.0, torques.get(name, 0.0)) for name in (*FRICTION, *CONTACT_FRICTION)]
    named = dict(zip(KEPT_FRICTION, values, strict=True))
    return {"friction": {"values": named, "covariance": np.zeros((4, 4)).tolist()}}


@dataclass(frozen=True)
class _Case:
    """Inputs of a validation, with which a cause can be tried."""

    compared: tuple[PointComparison, ...]
    rig: Rig
    identified: IdentifiedParameters
    differences: Differences
    causes: tuple[Cause, ...]
    releases: tuple[Rows, ...] = ()

    def explained(self) -> Explanations:
        return explanations(self.differences, self.causes, self.again, self.turned)

    def again(self, name: str, value: float) -> Differences | None:
        """Return the differences with a parameter or a number of the rig file at another value.

        Values identified with such a number change with it.
        """
        rig, values, changed = self.rig, dict(self.identified.values), dict[str, float]()
        try:
            provenance = self.identified.provenance
            if name in values:
                values[name] = value
            elif torques := torques_of(name, value):
                changed |= torques
                provenance = {**provenance, **_as_kept(torques)}
            elif name in PHYSICAL:
                change = value - rig.known.values[name]
                changed[name] = change
                rig = rig.with_number(name, value)
                slopes = self.identified.by_number.get(name, np.zeros(len(values)))
                values = {n: v + float(s) * change for (n, v), s in zip(values.items(), slopes, strict=True)}
            else:
                return None
            identified = replace(self.identified, values=values, provenance=provenance)
            changed |= {n: v - self.identified.values[n] for n, v in values.items()}
            predicted = [self._predicted(each, rig, identified) for each in self.compared]
            return differences(predicted, rig, identified, self.releases, changed)
        except (NoStableState, DynamicsError, RigConfigError, np.linalg.LinAlgError) as error:
            _log.info("%s = %.6g is not compared: the model has no such state: %s", name, value, error)
            return None

    def turned(self, kind: str, value_m: complex) -> Differences | None:
        """Return the differences with more run-out or bow; kind: "run-out" or "bow", the start in SLOW_ROLL."""
        roll = self.identified.slow_roll or SlowRoll(0j, 0j, 0j, np.zeros((6, 6)))
        if kind == "run-out":
            roll = replace(roll, run_out_x_m=roll.run_out_x_m + value_m, run_out_y_m=roll.run_out_y_m + value_m)
        else:
            roll = replace(roll, bow_m=roll.bow_m + value_m)
        identified = replace(self.identified, slow_roll=roll)
        try:
            predicted = [self._predicted(each, self.rig, identified) for each in self.compared]
        except (NoStableState, DynamicsError, np.linalg.LinAlgError) as error:
            _log.info("%s of %.3g m is not compared: the model has no such state: %s", kind, abs(value_m), error)
            return None
        changed = {f"{kind} along": value_m.real, f"{kind} across": value_m.imag}
        return differences(predicted, self.rig, identified, self.releases, changed)

    @staticmethod
    def _predicted(each: PointComparison, rig: Rig, identified: IdentifiedParameters) -> PointComparison:
        speed, near = each.measured.speed_rad_s, [theta.value for theta in each.measured.theta_rad]
        found = predict_point(rig, identified, speed.value, speed_std_rad_s=speed.std, near_rad=near)
        return PointComparison(each.name, each.measured, found)
