"""Generalised least squares over tests, with errors that tests share carried through.

Each test weighs by its own total covariance. Errors that tests share (a gain, a device's clock rate) do not average
out, so the joint covariance carries them as fully correlated: with p = W d and one shared error of shifts v_i per test
it adds (W v)(W v)ᵀ. Weights from the fully correlated matrix itself would be optimal only if the correlation were
exactly one; they can leave the range of the data, these can not. An error in what the tests together have found (the
pendulums' friction) does not weigh: it went into every test alike. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from rig_configs.parameters_file import PARAMETER_UNITS


@dataclass(frozen=True)
class Weighted:
    """A linear combination of tests.

    Attributes:
        names: n parameters.
        values: shape (n,), SI.
        pulls: W_i, one (n, m_i) per estimate: values = Σ W_i d_i.
        own: Σ W_i C_i W_iᵀ, what averages out, shape (n, n).
        shared: label → the joint values' shift for one standard deviation of a shared error, shape (n,).
        by_number: known number → derivative of the joint values by it, shape (n,).
    """

    names: tuple[str, ...]
    values: np.ndarray
    pulls: list[np.ndarray]
    own: np.ndarray
    shared: dict[str, np.ndarray]
    by_number: dict[str, np.ndarray]

    @property
    def covariance(self) -> np.ndarray:
        """Own and shared errors together, shape (n, n), symmetric."""
        total = self.own + sum((np.outer(v, v) for v in self.shared.values()), np.zeros_like(self.own))
        return 0.5 * (total + total.T)


def parameter_names(estimates: Sequence[Estimate]) -> tuple[str, ...]:
    """Every parameter that any estimate has, in the file's order."""
    return tuple(n for n in PARAMETER_UNITS if any(n in e.names for e in estimates))


def weighted(estimates: Sequence[Estimate]) -> Weighted:
    """The joint values of everything the estimates hold.

    Args:
        estimates: one per test; one without names pulls nothing.
    Raises:
        NotIdentifiable: there is no parameter in any of them.
    """
    names = parameter_names(estimates)
    if not names:
        raise NotIdentifiable("no test gave any parameter")
    scale = np.array([next(abs(e.value(n)) for e in estimates if n in e.names) or 1.0 for n in names])
    information = np.zeros((len(names), len(names)))
    pulls = []
    for estimate in estimates:
        columns = [names.index(n) for n in estimate.names]
        design = np.eye(len(names))[columns]
        unit = scale[columns]
        pull = design.T @ np.linalg.inv(estimate.weighing_covariance / np.outer(unit, unit))
        information += pull @ design
        pulls.append(scale[:, None] * pull / unit)
    inverse = np.linalg.inv(information)
    inverse = inverse * np.outer(scale, 1 / scale)
    pulls = [inverse @ pull for pull in pulls]
    return Weighted(names, *_moments(names, estimates, pulls))


def _moments(
    names: tuple[str, ...], estimates: Sequence[Estimate], pulls: list[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    n = len(names)
    values, own = np.zeros(n), np.zeros((n, n))
    shared: dict[str, np.ndarray] = {}
    by_number: dict[str, np.ndarray] = {}
    for estimate, pull in zip(estimates, pulls, strict=True):
        values += pull @ estimate.values
        own += pull @ estimate.covariance @ pull.T
        for label, shift in estimate.shared.items():
            shared[label] = shared.get(label, np.zeros(n)) + pull @ shift
        for number, slope in estimate.by_number.items():
            by_number[number] = by_number.get(number, np.zeros(n)) + pull @ slope
    return values, pulls, own, shared, by_number
