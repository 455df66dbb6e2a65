"""Measured minus predicted values at all points, with all contributions to their uncertainty and correlation.

A row is one quantity of one point: θ3, θ4 and the order-1 amplitudes of x and y. Where the model predicts no vibration
the real and the imaginary part of each amplitude are rows. The rms radius follows from these and has no row. The motion
right after a release has rows of its own in standard deviations, from the module that fitted it (`Rows`). An error that
enters both the measurement and the prediction (a laser's gain through S_P, an encoder's zero, a mass) counts once, with
the difference of its two effects. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from analysis.prediction import Prediction
from analysis.run_out import SLOW_ROLL, by_slow_roll
from analysis.steady_state import SteadyMeasurement
from rig_basics.arrays import Array
from rig_configs import IdentifiedParameters, Rig
from rig_configs.drag import Reading
from rig_configs.error_label import ErrorLabel
from rig_configs.known import ZERO_A, ZERO_B

_ROWS = ("θ3", "θ4", "x amplitude", "y amplitude")
_NOISE_ROWS = ("θ3", "θ4", "x real", "x imaginary", "y real", "y imaginary")
_MIN_EIGENVALUE = 1e-10  # of the rows' correlation
RELEASE = "release"
"""Start of the names of a release's rows, and suffix of its point's name for a separate verdict."""


class Rows(Protocol):
    """Rows of one release or of another test, linear in the assumed values: m rows, n parameters."""

    @property
    def point(self) -> str:
        """Name of the point or of the test."""
        ...

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows; those of a release begin with RELEASE."""
        ...

    @property
    def values(self) -> Array:
        """Measured − predicted, any unit, shape (m,)."""
        ...

    @property
    def own(self) -> Array:
        """Covariance of the errors that only this release has, shape (m, m)."""
        ...

    @property
    def by_parameter(self) -> Array:
        """Derivatives of the values by identified parameters, shape (m, n)."""
        ...

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of these parameters."""
        ...

    @property
    def by_number(self) -> Mapping[str, Array]:
        """Number of the rig file → derivative of the values by it at fixed parameters, shape (m,)."""
        ...

    @property
    def shared(self) -> Mapping[ErrorLabel, Array]:
        """Label → shift of the values per standard deviation of an error shared with other rows, shape (m,)."""
        ...

    @property
    def by_slow_roll(self) -> Mapping[str, Array]:
        """Name of SLOW_ROLL → change of the values per metre of it beyond the assumed value, shape (m,)."""
        ...

    @property
    def used_for(self) -> tuple[str, ...]:
        """Parameters that were identified with this release."""
        ...

    @property
    def remark(self) -> str:
        """A sentence about an effect that no test has identified; empty without one."""
        ...

    @property
    def reading(self) -> Reading:
        """Interpretation of an undecided torque with the square of the speed."""
        ...


@dataclass(frozen=True)
class PointComparison:
    """Measurement of one point with the prediction for its speed."""

    name: str
    measured: SteadyMeasurement
    predicted: Prediction


@dataclass(frozen=True)
class Differences:
    """All rows of all points.

    Attributes:
        rows: point and quantity of each row, m of them.
        values: measured − predicted, rad and m, rows of a release in their own unit, shape (m,).
        own: covariance of errors that only one row or one point has: statistics, rounding, remaining approach, speed;
            shape (m, m).
        by_parameter: derivatives of the differences by the identified parameters, shape (m, n).
        parameters: names of these, n of them.
        parameter_covariance: covariance of these without the shared errors, shape (n, n).
        uncertain: by_parameter with 0 where a parameter was identified with the row's release, shape (m, n). The
            error of such a parameter consists of the release's own noise. Adding both would count this noise twice,
            although it reduces the difference: with the derivative B of the rows and the covariance C of such
            parameters the covariance is 1 − B C Bᵀ. The covariance without it is still too large rather than too small.
        by_number: number of the rig file → derivative of the differences by it at fixed parameters, shape (m,).
        shared: label → shift of the differences per standard deviation of an error that rows share, shape (m,).
        by_slow_roll: name of SLOW_ROLL → change of the differences per metre of it beyond the value used, shape (m,).
    """

    rows: tuple[tuple[str, str], ...]
    values: Array
    own: Array
    by_parameter: Array
    parameters: tuple[str, ...]
    parameter_covariance: Array
    uncertain: Array
    by_number: Mapping[str, Array]
    shared: Mapping[ErrorLabel, Array]
    by_slow_roll: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the differences, shape (m, m)."""
        total = self.own + self.uncertain @ self.parameter_covariance @ self.uncertain.T
        for shift in self.shared.values():
            total = total + np.outer(shift, shift)
        return 0.5 * (total + total.T)

    @cached_property
    def whitener(self) -> Array:
        """Matrix W with WᵀW the inverse of the covariance, shape (m, m)."""
        std = np.sqrt(np.diag(self.covariance))
        sizes, turn = np.linalg.eigh(self.covariance / np.outer(std, std))
        return (turn / np.sqrt(np.maximum(sizes, _MIN_EIGENVALUE))).T / std

    @property
    def chi2(self) -> float:
        """Sum of squares in standard deviations with correlations; the degrees of freedom are the number of rows."""
        white = self.whitener @ self.values
        return float(white @ white)

    @property
    def groups(self) -> dict[str, list[int]]:
        """Rows with a verdict of their own: "A" of a point's steady state, "A release" of the motion before it."""
        found: dict[str, list[int]] = {}
        for i, (point, row) in enumerate(self.rows):
            name = f"{point} {RELEASE}" if row.startswith(RELEASE) else point
            found.setdefault(name, []).append(i)
        return found

    def of(self, at: Sequence[int]) -> Differences:
        """Return some of the rows.

        Args:
            at: indices of the rows.
        """
        at = list(at)
        return Differences(
            tuple(self.rows[i] for i in at),
            self.values[at],
            self.own[np.ix_(at, at)],
            self.by_parameter[at],
            self.parameters,
            self.parameter_covariance,
            self.uncertain[at],
            {n: v[at] for n, v in self.by_number.items()},
            {label: v[at] for label, v in self.shared.items()},
            {n: v[at] for n, v in self.by_slow_roll.items()},
        )


def differences(
    compared: Sequence[PointComparison],
    rig: Rig,
    identified: IdentifiedParameters,
    releases: Sequence[Rows] = (),
    changed: Mapping[str, float] | None = None,
) -> Differences:
    """Return the rows of all points.

    Args:
        compared: points whose measured state is the predicted one.
        rig: rig file with the uncertainties of gains and zeros.
        identified: parameters behind the predictions.
        releases: rows of the motions right after releases.
        changed: parameter, number of the rig file or component of SLOW_ROLL → its value minus the value behind the
            releases' rows.
    """
    names = tuple(identified.values)
    parts = [(each.name, _Part.of(each, rig)) for each in compared]
    parts += [(each.point, _Part.of_release(each, names, changed or {})) for each in releases]
    return _joined(parts, rig, identified)


def _joined(named: Sequence[tuple[str, _Part]], rig: Rig, identified: IdentifiedParameters) -> Differences:
    parts = [part for _, part in named]
    granted = [math.radians(rig.validation.model_std_deg), 1e-3 * rig.validation.model_std_mm]
    labels = dict.fromkeys(label for part in parts for label in part.shared)
    numbers = dict.fromkeys(name for part in parts for name in part.by_number)
    sizes = [len(part.values) for part in parts]
    own, at = np.zeros((sum(sizes), sum(sizes))), 0
    for part, size in zip(parts, sizes, strict=True):
        allowance = np.r_[np.full(2, granted[0]), np.full(size - 2, granted[1])] if part.steady else np.zeros(size)
        own[at : at + size, at : at + size] = part.own + np.diag(allowance**2)
        at += size

    def joined(of: str, key: str | ErrorLabel) -> Array:
        return np.concatenate([getattr(part, of).get(key, np.zeros(len(part.values))) for part in parts])

    names, n = list(identified.values), len(identified.values)
    return Differences(
        tuple((name, row) for name, part in named for row in part.rows),
        np.concatenate([part.values for part in parts] or [np.empty(0)]),
        own,
        np.concatenate([part.by_parameter for part in parts] or [np.empty((0, n))]),
        tuple(identified.values),
        identified.own_covariance,
        np.concatenate([part.by_parameter * ~np.isin(names, part.used_for) for part in parts] or [np.empty((0, n))]),
        {name: joined("by_number", name) for name in numbers},
        {label: joined("shared", label) for label in labels},
        {name: joined("by_slow_roll", name) for name in SLOW_ROLL},
    )


@dataclass(frozen=True)
class _Part:
    """Rows of one point's steady state or of its release."""

    rows: tuple[str, ...]
    values: Array
    own: Array
    by_parameter: Array
    by_number: Mapping[str, Array]
    shared: Mapping[ErrorLabel, Array]
    used_for: tuple[str, ...] = ()
    steady: bool = True
    by_slow_roll: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @classmethod
    def of_release(cls, release: Rows, parameters: Sequence[str], changed: Mapping[str, float]) -> _Part:
        """Return a release's rows, shifted to the changed values."""
        by = dict(zip(release.parameters, release.by_parameter.T, strict=True))
        values = release.values.copy()
        for name, change in changed.items():
            by_cause = -release.by_slow_roll.get(name, np.zeros(len(values)))
            values = values + change * by.get(name, release.by_number.get(name, by_cause))
        columns = [by.get(name, np.zeros(len(values))) for name in parameters]
        by_parameter = np.stack(columns, axis=1) if columns else np.zeros((len(values), 0))
        return cls(
            release.rows,
            values,
            release.own,
            by_parameter,
            release.by_number,
            release.shared,
            release.used_for,
            False,
            release.by_slow_roll,
        )

    @classmethod
    def of(cls, compared: PointComparison, rig: Rig) -> _Part:
        measured, predicted = compared.measured, compared.predicted
        seen = measured_shifts(measured, rig)
        shared = {
            label: seen.get(label, np.zeros(5)) - predicted.shared.get(label, np.zeros(5))
            for label in dict.fromkeys([*seen, *predicted.shared])
        }
        off = measured_values(measured) - predicted.values
        off[:2] = (off[:2] + math.pi) % (2 * math.pi) - math.pi
        own = measured.own + predicted.own + np.diag(predicted.numerical**2)
        if not predicted.at_rest:
            pick = np.eye(5)[:4]
            return cls(
                _ROWS,
                pick @ off,
                pick @ own @ pick.T,
                -pick @ predicted.by_parameter,
                {n: -pick @ v for n, v in predicted.by_number.items()},
                {n: pick @ v for n, v in shared.items()},
                by_slow_roll=by_slow_roll(measured, predicted),
            )
        pick = np.zeros((6, 5))
        pick[0, 0] = pick[1, 1] = 1.0  # amplitudes near zero depend on noise only
        x, y = measured.x_m, measured.y_m
        values = pick @ off + np.array([0.0, 0.0, x.real, x.imag, y.real, y.imag])
        own = measured.to_come.covariance + pick @ predicted.own @ pick.T
        own[2:, 2:] += np.diag(np.repeat(held_variance(predicted), 2))
        return cls(
            _NOISE_ROWS,
            values,
            own,
            -pick @ predicted.by_parameter,
            {n: -pick @ v for n, v in predicted.by_number.items()},
            {n: pick @ v for n, v in shared.items()},
            by_slow_roll=by_slow_roll(measured, predicted),
        )


def held_variance(predicted: Prediction) -> Array:
    """Return the variance of the real or imaginary part of x and y where dry friction leaves a vibration, m².

    The variance is that of either axis: the small angle between springs and sensors has no influence on it.
    """
    return np.zeros(2) if predicted.held is None else predicted.held.whirl_variance_m2


def measured_values(measured: SteadyMeasurement) -> Array:
    """Return θ3, θ4, amplitudes of x and y and the rms radius, in the order of QUANTITIES, shape (5,), rad and m."""
    m = measured
    return np.array([v.value for v in (*m.theta_rad, m.amplitude_x_m, m.amplitude_y_m, m.amplitude_m)])


def measured_shifts(measured: SteadyMeasurement, rig: Rig) -> dict[ErrorLabel, Array]:
    """Return label → shift of the measured values per standard deviation of a shared error, shape (5,).

    The order is that of analysis.prediction.QUANTITIES.
    """
    gain_x, gain_y = rig.roles.gain_stds
    zero = math.radians(rig.roles.zero_std_deg)
    x, y, radius = measured.amplitude_x_m.value, measured.amplitude_y_m.value, measured.amplitude_m.value
    share = 0.5 / radius if radius > 0 else 0.0
    return {
        ErrorLabel("gain", "x"): gain_x * np.array([0.0, 0.0, x, 0.0, share * x * x]),
        ErrorLabel("gain", "y"): gain_y * np.array([0.0, 0.0, 0.0, y, share * y * y]),
        ErrorLabel("known", ZERO_A): -zero * np.eye(5)[0],  # a larger zero yields a smaller angle
        ErrorLabel("known", ZERO_B): -zero * np.eye(5)[1],
    }
