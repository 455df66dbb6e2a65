"""Comparison of each test's value of a parameter with the values of the other tests."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from identification.estimate import Estimate
from identification.joint.agreement import covariance_of_all
from identification.sources import Sources


@dataclass(frozen=True)
class ConsistencyRow:
    """Value of one parameter from one test, compared with the other tests.

    Attributes:
        parameter, test, sources: parameter, test name and logs.
        value, std: value of this test and its standard deviation including shared errors, SI.
        others, others_std: combined value of the other tests that are not left out and its standard deviation, SI.
        z: difference over its standard deviation.
        chi2, dof, p: χ² test over all tests of the parameter.
        left_out: whether the joint estimate excludes this value.
    """

    parameter: str
    test: str
    sources: Sources
    value: float
    std: float
    others: float
    others_std: float
    z: float
    chi2: float
    dof: int
    p: float
    left_out: bool = False


def rows_of(name: str, estimates: Sequence[Estimate], left_out: Collection[int] = ()) -> list[ConsistencyRow]:
    """Return a row for each test with the parameter; an empty list if fewer than two tests have it.

    Args:
        name: parameter.
        estimates: one per test.
        left_out: indices of tests that the joint estimate excludes. They are not used for `others`.
    """
    having = [i for i, e in enumerate(estimates) if name in e.names]
    if len(having) < 2:
        return []
    values, matrix = values_and_covariance(name, [estimates[i] for i in having])
    chi2 = spread(values, matrix)
    dof = len(having) - 1
    p = float(chdtrc(dof, chi2))
    out: list[ConsistencyRow] = []
    for k, i in enumerate(having):
        rest = [j for j, at in enumerate(having) if j != k and at not in left_out]
        rest = rest or [j for j in range(len(having)) if j != k]
        inner = np.linalg.inv(matrix[np.ix_(rest, rest)])
        pull = inner.sum(axis=0) / inner.sum()
        others = float(pull @ values[rest])
        contrast = np.zeros(len(having))
        contrast[k], contrast[rest] = 1.0, -pull
        apart = float(np.sqrt(contrast @ matrix @ contrast))
        out.append(
            ConsistencyRow(
                name,
                estimates[i].test,
                estimates[i].sources,
                float(values[k]),
                float(np.sqrt(matrix[k, k])),
                others,
                float(np.sqrt(pull @ matrix[np.ix_(rest, rest)] @ pull)),
                float((values[k] - others) / apart),
                chi2,
                dof,
                p,
                i in left_out,
            )
        )
    return out


def values_and_covariance(name: str, having: Sequence[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Values of one parameter in m tests and their covariance, shapes (m,) and (m, m)."""
    begins = np.cumsum([0, *(len(e.names) for e in having)])[:-1].tolist()
    at = [begin + e.names.index(name) for begin, e in zip(begins, having, strict=True)]
    return np.array([e.value(name) for e in having]), covariance_of_all(having)[np.ix_(at, at)]


def spread(values: np.ndarray, matrix: np.ndarray) -> float:
    """χ² of values about their weighted mean."""
    inverse = np.linalg.inv(matrix)
    residual = values - inverse.sum(axis=0) @ values / inverse.sum()
    return float(residual @ inverse @ residual)
