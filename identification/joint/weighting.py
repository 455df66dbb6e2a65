"""Generalised least squares over tests, with propagation of errors that tests share.

The weight of a test is the inverse of its total covariance. Shared errors (a gain, a device's clock rate) do not
average out; the joint covariance contains them as fully correlated. With p = W d and the shifts v_i of one shared error
per test it adds (W v)(W v)ᵀ. Weights from the fully correlated matrix would be optimal only if the correlation were
exactly one, and their result can lie outside the range of the data. Errors in quantities that the tests find together
(the pendulums' friction) do not affect the weights: they are the same in every test.
Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from rig_configs.error_label import ErrorLabel
from rig_configs.parameters_file import PARAMETER_UNITS


@dataclass(frozen=True)
class Weighted:
    """Linear combination of tests.

    Attributes:
        names: names of the n parameters.
        values: joint values, shape (n,), SI.
        pulls: weights W_i, shape (n, m_i) per estimate: values = Σ W_i d_i.
        own: covariance Σ W_i C_i W_iᵀ of the errors that average out, shape (n, n).
        shared: label → shift of the joint values for one standard deviation of a shared error, shape (n,).
        by_number: known number → derivative of the joint values by it, shape (n,).
    """

    names: tuple[str, ...]
    values: np.ndarray
    pulls: list[np.ndarray]
    own: np.ndarray
    shared: dict[ErrorLabel, np.ndarray]
    by_number: dict[str, np.ndarray]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of own and shared errors, shape (n, n), symmetric."""
        total = self.own + sum((np.outer(v, v) for v in self.shared.values()), np.zeros_like(self.own))
        return 0.5 * (total + total.T)


def parameter_names(estimates: Sequence[Estimate]) -> tuple[str, ...]:
    """Parameters that at least one estimate has, in the file's order."""
    return tuple(n for n in PARAMETER_UNITS if any(n in e.names for e in estimates))


def weighted(estimates: Sequence[Estimate]) -> Weighted:
    """Combine the estimates by generalised least squares.

    Args:
        estimates: one per test. An estimate without names has no influence.
    Raises:
        NotIdentifiable: no estimate contains a parameter.
    """
    names = parameter_names(estimates)
    if not names:
        raise NotIdentifiable("no test gave any parameter")
    scale = np.array([next(abs(e.value(n)) for e in estimates if n in e.names) or 1.0 for n in names])
    information = np.zeros((len(names), len(names)))
    pulls: list[np.ndarray] = []
    for estimate in estimates:
        columns = [names.index(n) for n in estimate.names]
        design = np.eye(len(names))[columns]
        unit = scale[columns]
        pull = design.T @ np.linalg.inv(estimate.weighing_covariance / np.outer(unit, unit))
        information += pull @ design
        pulls.append(scale[:, None] * pull / unit)
    inverse: np.ndarray = np.linalg.inv(information)
    inverse = inverse * np.outer(scale, 1 / scale)
    pulls = [inverse @ pull for pull in pulls]
    return Weighted(names, *_moments(names, estimates, pulls))


def _moments(
    names: tuple[str, ...], estimates: Sequence[Estimate], pulls: list[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, dict[ErrorLabel, np.ndarray], dict[str, np.ndarray]]:
    n = len(names)
    values, own = np.zeros(n), np.zeros((n, n))
    shared: dict[ErrorLabel, np.ndarray] = {}
    by_number: dict[str, np.ndarray] = {}
    for estimate, pull in zip(estimates, pulls, strict=True):
        values += pull @ estimate.values
        own += pull @ estimate.covariance @ pull.T
        for label, shift in estimate.shared.items():
            shared[label] = shared.get(label, np.zeros(n)) + pull @ shift
        for number, slope in estimate.by_number.items():
            by_number[number] = by_number.get(number, np.zeros(n)) + pull @ slope
    return values, pulls, own, shared, by_number
