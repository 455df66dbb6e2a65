"""Several tests' answers as one: generalised least squares, and how far each test agrees with the others.

Weights come from each test's total covariance. Errors that tests share (a gain, a device's clock rate) do not average
out, so the combined covariance carries them as fully correlated: with p = W d and one shared error of shifts v_i per
test it adds (W v)(W v)ᵀ. Weights from the fully correlated matrix itself would be optimal only if the correlation were
exactly one; they can leave the range of the data, these can not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from rig_configs.parameters_file import PARAMETER_UNITS, IdentifiedParameters

DISAGREES = 1e-4
_INFLATE_BELOW = 1e-2


@dataclass(frozen=True)
class ConsistencyRow:
    """One parameter as one test found it, against the other tests.

    Attributes:
        parameter, test, source: what and where.
        value, std: this test's, SI, shared errors included.
        others, others_std: the other tests' combination.
        z: difference over its standard deviation.
        chi2, dof, p: all tests of the parameter together.
    """

    parameter: str
    test: str
    source: str
    value: float
    std: float
    others: float
    others_std: float
    z: float
    chi2: float
    dof: int
    p: float


def combine(estimates: Sequence[Estimate]) -> tuple[IdentifiedParameters, list[ConsistencyRow], list[str]]:
    """The joint estimate of everything any test found.

    Args:
        estimates: one per test, in any order.
    Returns:
        Parameters in the file's order, a row per parameter and test for parameters found more than once, warnings.
    Raises:
        NotIdentifiable: no estimate at all.
    """
    names = [n for n in PARAMETER_UNITS if any(n in e.names for e in estimates)]
    if not names:
        raise NotIdentifiable("no test gave any parameter")
    values, covariance = _weighted(names, estimates)
    rows, warnings = [], []
    stretch = np.ones(len(names))
    for i, name in enumerate(names):
        own = _rows(name, estimates)
        if not own:
            continue
        rows += own
        if own[0].p < _INFLATE_BELOW:
            stretch[i] = np.sqrt(max(1.0, own[0].chi2 / own[0].dof))
        if own[0].p < DISAGREES:
            worst = max(own, key=lambda r: abs(r.z))
            warnings.append(
                f"{name}: tests disagree (χ² {worst.chi2:.3g} for {worst.dof}, p = {worst.p:.1g}); "
                f"{_most_apart(own)} is the farthest off. Its standard deviation is scaled up by {stretch[i]:.3g}"
            )
    covariance = covariance * np.outer(stretch, stretch)
    table = dict(zip(names, values.tolist(), strict=True))
    return IdentifiedParameters(table, 0.5 * (covariance + covariance.T)), rows, warnings


def _weighted(names: Sequence[str], estimates: Sequence[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Generalised least squares over the named parameters; every name must occur."""
    used = [e for e in estimates if any(n in names for n in e.names)]
    scale = np.array([next(abs(e.value(n)) for e in used if n in e.names) or 1.0 for n in names])
    information = np.zeros((len(names), len(names)))
    parts = []
    for estimate in used:
        rows = [i for i, n in enumerate(estimate.names) if n in names]
        columns = [names.index(estimate.names[i]) for i in rows]
        design = np.zeros((len(rows), len(names)))
        design[range(len(rows)), columns] = 1.0
        unit = scale[columns]
        total = estimate.total_covariance[np.ix_(rows, rows)] / np.outer(unit, unit)
        pull = design.T @ np.linalg.inv(total)
        information += pull @ design
        own = estimate.covariance[np.ix_(rows, rows)] / np.outer(unit, unit)
        shared = {label: v[rows] / unit for label, v in estimate.shared.items()}
        parts.append((pull, estimate.values[rows] / unit, own, shared))
    inverse = np.linalg.inv(information)
    values = inverse @ sum(pull @ d for pull, d, _, _ in parts)
    covariance = sum(inverse @ pull @ own @ pull.T @ inverse for pull, _, own, _ in parts)
    labels = sorted({label for _, _, _, shared in parts for label in shared})
    for label in labels:
        moved = inverse @ sum(pull @ shared[label] for pull, _, _, shared in parts if label in shared)
        covariance = covariance + np.outer(moved, moved)
    return values * scale, covariance * np.outer(scale, scale)


def _rows(name: str, estimates: Sequence[Estimate]) -> list[ConsistencyRow]:
    """How each test's value of one parameter stands against the rest; shared errors cancel in the difference."""
    having = [e for e in estimates if name in e.names]
    if len(having) < 2:
        return []
    values = np.array([e.value(name) for e in having])
    index = [e.names.index(name) for e in having]
    matrix = np.diag([e.covariance[i, i] for e, i in zip(having, index, strict=True)])
    for label in {label for e in having for label in e.shared}:
        shift = np.array([e.shared[label][i] if label in e.shared else 0.0 for e, i in zip(having, index, strict=True)])
        # the same device's clock line is fitted anew in every log: its error need not be the same
        matrix += np.diag(shift**2) if label.startswith("clock") else np.outer(shift, shift)
    inverse = np.linalg.inv(matrix)
    weights = inverse.sum(axis=0) / inverse.sum()
    residual = values - weights @ values
    chi2 = float(residual @ inverse @ residual)
    dof = len(having) - 1
    p = float(chi2_distribution.sf(chi2, dof))
    out = []
    for k, estimate in enumerate(having):
        rest = [j for j in range(len(having)) if j != k]
        inner = np.linalg.inv(matrix[np.ix_(rest, rest)])
        pull = inner.sum(axis=0) / inner.sum()
        others = float(pull @ values[rest])
        contrast = np.zeros(len(having))
        contrast[k], contrast[rest] = 1.0, -pull
        spread = float(np.sqrt(contrast @ matrix @ contrast))
        out.append(
            ConsistencyRow(
                name, estimate.test, estimate.source, float(values[k]), float(np.sqrt(matrix[k, k])), others,
                float(np.sqrt(pull @ matrix[np.ix_(rest, rest)] @ pull)), float((values[k] - others) / spread),
                chi2, dof, p,
            )
        )  # fmt: skip
    return out


def _most_apart(rows: list[ConsistencyRow]) -> str:
    """The test whose removal mends most; with two tests nobody can tell, so both are named."""
    if len(rows) == 2:
        return f"{rows[0].test} ({rows[0].source}) or {rows[1].test} ({rows[1].source})"
    worst = max(rows, key=lambda r: abs(r.z))
    return f"{worst.test} ({worst.source})"
