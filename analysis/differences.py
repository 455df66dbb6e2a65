# pyright: strict
"""Measured minus predicted at all points, with everything that makes the differences uncertain and correlated.

A row is one quantity of one point: θ3, θ4 and the order-1 amplitudes of x and y; where the model says "no vibration"
the real and the imaginary part of an amplitude. The rms radius follows from these and is no row. An error that enters
both the measurement and the prediction (a laser's gain through S_P, an encoder's zero, a mass) counts once, with the
difference of its two effects. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.prediction import Prediction
from analysis.steady_state import SteadyMeasurement
from rig_configs import IdentifiedParameters, Rig
from rig_configs.known import ZERO_A, ZERO_B, gain_label, known_label

Array = NDArray[np.float64]

_ROWS = ("θ3", "θ4", "x amplitude", "y amplitude")
_NOISE_ROWS = ("θ3", "θ4", "x real", "x imaginary", "y real", "y imaginary")
_LEAST = 1e-10  # least eigenvalue of the rows' correlation


@dataclass(frozen=True)
class Compared:
    """One point's measurement with the prediction for its speed."""

    name: str
    measured: SteadyMeasurement
    predicted: Prediction


@dataclass(frozen=True)
class Differences:
    """All rows of all points.

    Attributes:
        rows: point and quantity of each row, m of them.
        values: measured − predicted, rad and m, shape (m,).
        own: covariance of what only one row or one point has: statistics, rounding, what was still to come, the speed;
            shape (m, m).
        by_parameter: derivatives of the differences by the identified parameters, shape (m, n).
        parameters: names of these, n of them.
        parameter_covariance: their own covariance, without the shared errors, shape (n, n).
        by_number: number of the rig file → derivative of the differences by it, the parameters as they are, shape (m,).
        shared: label → shift of the differences for one standard deviation of an error that rows share, shape (m,).
    """

    rows: tuple[tuple[str, str], ...]
    values: Array
    own: Array
    by_parameter: Array
    parameters: tuple[str, ...]
    parameter_covariance: Array
    by_number: Mapping[str, Array]
    shared: Mapping[str, Array]

    @cached_property
    def covariance(self) -> Array:
        """Of the differences, shape (m, m)."""
        total = self.own + self.by_parameter @ self.parameter_covariance @ self.by_parameter.T
        for shift in self.shared.values():
            total = total + np.outer(shift, shift)
        return 0.5 * (total + total.T)

    @cached_property
    def whitener(self) -> Array:
        """W with WᵀW the inverse of the covariance, shape (m, m)."""
        std = np.sqrt(np.diag(self.covariance))
        sizes, turn = np.linalg.eigh(self.covariance / np.outer(std, std))
        return (turn / np.sqrt(np.maximum(sizes, _LEAST))).T / std

    @property
    def chi2(self) -> float:
        """Σ of squares in standard deviations, correlations taken into account; as many degrees as rows."""
        white = self.whitener @ self.values
        return float(white @ white)

    def of(self, point: str) -> Differences:
        """One point's rows alone."""
        at = [i for i, (name, _) in enumerate(self.rows) if name == point]
        return Differences(
            tuple(self.rows[i] for i in at), self.values[at], self.own[np.ix_(at, at)], self.by_parameter[at],
            self.parameters, self.parameter_covariance, {n: v[at] for n, v in self.by_number.items()},
            {label: v[at] for label, v in self.shared.items()},
        )  # fmt: skip


def differences(compared: Sequence[Compared], rig: Rig, identified: IdentifiedParameters) -> Differences:
    """The rows of all points.

    Args:
        compared: points whose state is the predicted one.
        rig: gains' and zeros' uncertainties.
        identified: what the predictions were made with.
    """
    parts = [_Part.of(each, rig) for each in compared]
    granted = [math.radians(rig.validation.model_std_deg), 1e-3 * rig.validation.model_std_mm]
    labels = dict.fromkeys(label for part in parts for label in part.shared)
    numbers = dict.fromkeys(name for part in parts for name in part.by_number)
    sizes = [len(part.values) for part in parts]
    own, at = np.zeros((sum(sizes), sum(sizes))), 0
    for part, size in zip(parts, sizes, strict=True):
        allowance = np.r_[np.full(2, granted[0]), np.full(size - 2, granted[1])]
        own[at : at + size, at : at + size] = part.own + np.diag(allowance**2)
        at += size

    def joined(of: str, key: str) -> Array:
        return np.concatenate([getattr(part, of).get(key, np.zeros(len(part.values))) for part in parts])

    n = len(identified.values)
    return Differences(
        tuple((each.name, row) for each, part in zip(compared, parts, strict=True) for row in part.rows),
        np.concatenate([part.values for part in parts] or [np.empty(0)]),
        own,
        np.concatenate([part.by_parameter for part in parts] or [np.empty((0, n))]),
        tuple(identified.values),
        identified.own_covariance,
        {name: joined("by_number", name) for name in numbers},
        {label: joined("shared", label) for label in labels},
    )


@dataclass(frozen=True)
class _Part:
    """One point's rows."""

    rows: tuple[str, ...]
    values: Array
    own: Array
    by_parameter: Array
    by_number: dict[str, Array]
    shared: dict[str, Array]

    @classmethod
    def of(cls, compared: Compared, rig: Rig) -> _Part:
        measured, predicted = compared.measured, compared.predicted
        seen = measured_shifts(measured, rig)
        shared = {
            label: seen.get(label, np.zeros(5)) - predicted.shared.get(label, np.zeros(5))
            for label in dict.fromkeys([*seen, *predicted.shared])
        }
        off = measured_values(measured) - predicted.values
        off[:2] = (off[:2] + math.pi) % (2 * math.pi) - math.pi
        own = measured.own + predicted.own + np.diag(predicted.numerical**2)
        if predicted.state.type != "I":
            pick = np.eye(5)[:4]
            return cls(
                _ROWS, pick @ off, pick @ own @ pick.T, -pick @ predicted.by_parameter,
                {n: -pick @ v for n, v in predicted.by_number.items()}, {n: pick @ v for n, v in shared.items()},
            )  # fmt: skip
        pick = np.zeros((6, 5))
        pick[0, 0] = pick[1, 1] = 1.0  # amplitudes beside zero depend on nothing but noise
        x, y = measured.x_m, measured.y_m
        values = pick @ off + np.array([0.0, 0.0, x.real, x.imag, y.real, y.imag])
        own = measured.to_come.covariance + pick @ predicted.own @ pick.T
        return cls(
            _NOISE_ROWS, values, own, -pick @ predicted.by_parameter,
            {n: -pick @ v for n, v in predicted.by_number.items()}, {n: pick @ v for n, v in shared.items()},
        )  # fmt: skip


def measured_values(measured: SteadyMeasurement) -> Array:
    """θ3, θ4, amplitudes of x and y and the rms radius, in the order of QUANTITIES, shape (5,), rad and m."""
    m = measured
    return np.array([v.value for v in (*m.theta_rad, m.amplitude_x_m, m.amplitude_y_m, m.amplitude_m)])


def measured_shifts(measured: SteadyMeasurement, rig: Rig) -> dict[str, Array]:
    """How the measured values go with errors that other quantities share: label → shift, shape (5,).

    The order is that of analysis.prediction.QUANTITIES; one standard deviation of each error.
    """
    gain_x, gain_y = rig.roles.gain_stds
    zero = math.radians(rig.roles.zero_std_deg)
    x, y, radius = measured.amplitude_x_m.value, measured.amplitude_y_m.value, measured.amplitude_m.value
    share = 0.5 / radius if radius > 0 else 0.0
    return {
        gain_label("x"): gain_x * np.array([0.0, 0.0, x, 0.0, share * x * x]),
        gain_label("y"): gain_y * np.array([0.0, 0.0, 0.0, y, share * y * y]),
        known_label(ZERO_A): -zero * np.eye(5)[0],  # a larger zero is a smaller angle
        known_label(ZERO_B): -zero * np.eye(5)[1],
    }
