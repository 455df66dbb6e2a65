"""Agreement of the tests and detection of a deviating test, by mean-shift tests on the values of all tests.

The values of all tests form one vector d with design A (the parameter of each value) and covariance Σ. With
R = Σ⁻¹ − Σ⁻¹A (AᵀΣ⁻¹A)⁻¹ AᵀΣ⁻¹ the sum of squares is Q = dᵀ R d. Free shifts of the values in a set S, which are
equivalent to leaving these values out, reduce Q by ΔQ = u_Sᵀ R_SS⁺ u_S with u = R d. If the tests agree, ΔQ is a χ² of
rank(R_SS) degrees of freedom. S is each test as a whole and each single value. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaln

from identification.estimate import Estimate
from identification.joint.weighting import parameter_names
from rig_basics.arrays import Array

ALARM = 1e-3
"""Probability of an alarm if all tests are good."""

_MIN_SEPARATION = 12.0  # difference of −2 ln p between the worst test and the next one: odds of 400 to 1
_TOLERANCE_STD = 0.05  # of a value's total standard deviation: tolerated difference between tests
_MAX_TABULATED_CHI2 = 1e3  # above it, the tail probability is its leading term
_MIN_EIGENVALUE = 1e-9  # of a whitened matrix; smaller ones count as zero


@dataclass(frozen=True)
class AgreementVerdict:
    """Result of the agreement test.

    Attributes:
        p: smallest p value of all comparisons times their number. It is an alarm if below ALARM.
        suspects: indices of the tests that may be bad if there is an alarm, worst first; a single one if it is clear.
        names: parameters in which the worst test deviates if there is an alarm, worst first.
        z: deviation in each of these parameters in standard deviations, given all other values except those named
            before it.
        looks: number of comparisons.
    """

    p: float
    suspects: tuple[int, ...]
    names: tuple[str, ...]
    z: tuple[float, ...]
    looks: int

    @property
    def alarm(self) -> bool:
        """Whether the tests disagree."""
        return self.p < ALARM


def verdict(estimates: Sequence[Estimate]) -> AgreementVerdict:
    """Test whether the estimates agree. If they do not, find the tests that may be bad."""
    owner, names, residual, precision = _residual_system(estimates)
    tests = [_log_chance(residual, precision, np.flatnonzero(owner == i)) for i in range(len(estimates))]
    single, judged = _log_chances_of_each(residual, precision)
    looks = sum(rank > 0 for _, rank in tests) + int(np.count_nonzero(judged))
    if looks == 0:
        return AgreementVerdict(1.0, (), (), (), 0)
    # the smallest p value of a test's comparisons counts for the test
    worst = np.array([min([tests[i][0], *single[owner == i].tolist()]) for i in range(len(estimates))])
    order = np.argsort(worst)
    p = min(1.0, looks * float(np.exp(max(worst[order[0]], -700.0))))
    if p >= ALARM:
        return AgreementVerdict(p, (), (), (), looks)
    limit = np.log(ALARM / looks)
    near = [int(i) for i in order if 2 * (worst[i] - worst[order[0]]) < _MIN_SEPARATION and worst[i] < limit]
    apart, z = _apart(np.flatnonzero(owner == order[0]), residual, precision, float(np.log(ALARM / looks)))
    return AgreementVerdict(p, tuple(near), tuple(names[k] for k in apart), tuple(z), looks)


def _residual_system(estimates: Sequence[Estimate]) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Test index and name of each value, u and R, whitened so that each value has unit variance."""
    known = parameter_names(estimates)
    owner = np.concatenate([np.full(len(e.names), i) for i, e in enumerate(estimates)])
    names = [n for e in estimates for n in e.names]
    total = covariance_of_all(estimates)
    unit = np.sqrt(np.diag(total))
    middle = {n: np.median([e.value(n) for e in estimates if n in e.names]) for n in known}
    data = (np.concatenate([e.values for e in estimates]) - np.array([middle[n] for n in names])) / unit
    design = np.array([[float(n == m) for m in known] for n in names]) / unit[:, None]
    inverse = cast(Array, np.linalg.inv(total / np.outer(unit, unit)))
    scale = np.linalg.norm(design, axis=0)
    pull = (design / scale).T @ inverse
    precision = inverse - pull.T @ cast(Array, np.linalg.solve(pull @ (design / scale), pull))
    return owner, names, precision @ data, 0.5 * (precision + precision.T)


def covariance_of_all(estimates: Sequence[Estimate]) -> np.ndarray:
    """Covariance of the concatenated values of all tests, with common gains and with clock errors of each log's own.

    The line of a device's clock is fitted in every log. Its error may differ between logs and does not cancel between
    them. A twentieth of the total standard uncertainty of each value is added: if a shared error is nearly all of the
    uncertainty, differences between tests that are far below the uncertainty of the result must not cause an alarm.
    """
    edges = np.cumsum([0, *(len(e.names) for e in estimates)])
    total = np.zeros((edges[-1], edges[-1]))
    for estimate, begin in zip(estimates, edges, strict=False):
        here = slice(begin, begin + len(estimate.names))
        total[here, here] += estimate.covariance
        total[here, here] += sum(np.outer(v, v) for label, v in estimate.shared.items() if label.kind == "clock")
    for label in dict.fromkeys(label for e in estimates for label in e.shared if label.kind != "clock"):
        shift = np.concatenate([e.shared.get(label, np.zeros(len(e.names))) for e in estimates])
        total += np.outer(shift, shift)
    return total + np.diag(_TOLERANCE_STD**2 * np.diag(total))


def _apart(of: np.ndarray, residual: np.ndarray, precision: np.ndarray, limit: float) -> tuple[list[int], list[float]]:
    """Values of a test that deviate, and their z, by forward selection.

    Good values that are correlated with a bad one seem to deviate until the bad one has a free shift.
    """
    found: list[int] = []
    z: list[float] = []
    mended = 0.0
    while len(found) < len(of):
        rest = [int(k) for k in of if k not in found]
        gains = [_mended(residual, precision, np.array([*found, k])) for k in rest]
        best = int(np.argmax([gain for gain, _ in gains]))
        chance = _log_tail(gains[best][0] - mended, 1)
        if gains[best][1] <= len(found) or (found and chance > limit):
            break
        found.append(rest[best])
        z.append(float(np.copysign(np.sqrt(max(gains[best][0] - mended, 0.0)), residual[rest[best]])))
        mended = gains[best][0]
    return found, z


def _log_chance(residual: np.ndarray, precision: np.ndarray, of: np.ndarray) -> tuple[float, int]:
    """ln of the p value of ΔQ when these values are left out, and the degrees of freedom."""
    mended, rank = _mended(residual, precision, of)
    return (_log_tail(mended, rank) if rank else 0.0), rank


def _log_chances_of_each(residual: Array, precision: Array) -> tuple[Array, NDArray[np.bool_]]:
    """ln of the p value for each single value, shape (m,), and a mask of the values that other values determine."""
    own = np.diag(precision)
    judged = own > _MIN_EIGENVALUE
    mended = np.where(judged, residual**2 / np.where(judged, own, 1.0), 0.0)
    near: Array = np.log(chdtrc(1, np.minimum(mended, _MAX_TABULATED_CHI2)))
    half = 0.5 * np.maximum(mended, 1.0)
    far: Array = -half - 0.5 * np.log(half) - gammaln(0.5)
    return np.where(mended > _MAX_TABULATED_CHI2, far, near), judged


def _mended(residual: np.ndarray, precision: np.ndarray, of: np.ndarray) -> tuple[float, int]:
    """ΔQ of a set of values and its degrees of freedom."""
    if not len(of):
        return 0.0, 0
    size, vectors = np.linalg.eigh(precision[np.ix_(of, of)])
    # a value that no other value determines has no residual information
    kept = size > _MIN_EIGENVALUE * max(1.0, float(size[-1]))
    return float(np.sum((vectors[:, kept].T @ residual[of]) ** 2 / size[kept])), int(np.count_nonzero(kept))


def _log_tail(chi2: float, dof: int) -> float:
    """ln P(χ² of dof > chi2), also if P underflows (leading term)."""
    if chi2 > _MAX_TABULATED_CHI2:
        half = 0.5 * chi2
        return float(-half + (0.5 * dof - 1) * np.log(half) - gammaln(0.5 * dof))
    return float(np.log(chdtrc(dof, max(chi2, 0.0))))
