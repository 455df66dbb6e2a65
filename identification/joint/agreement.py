"""Do the tests agree, and which of them does not: mean-shift tests on all tests' values at once.

All tests' values stand in one vector d with design A (which value is of which parameter) and covariance Σ. With
R = Σ⁻¹ − Σ⁻¹A (AᵀΣ⁻¹A)⁻¹ AᵀΣ⁻¹ the sum of squares is Q = dᵀ R d, and giving the values in a set S shifts of their own
(which is the same as leaving them out) mends Q by ΔQ = u_Sᵀ R_SS⁺ u_S, u = R d, a χ² of rank(R_SS) degrees of freedom
when all is well. S is each test as a whole, and each single value. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, gammaln

from identification.estimate import Estimate
from identification.joint.weighting import parameter_names

ALARM = 1e-3
"""Chance that any test is called bad while all are good."""

_CLEARLY = 12.0  # −2 ln p by which the worst must stand apart from the next: odds of 400 to 1
_OF_NO_MATTER = 0.05  # of a value's total standard deviation: so small a difference between tests changes nothing
_FAR_OUT = 1e3
_RANK = 1e-9  # eigenvalue of a whitened matrix that counts as none


@dataclass(frozen=True)
class Verdict:
    """What the agreement test says of a set of tests.

    Attributes:
        p: chance of the worst look, times the number of looks; below ALARM it is an alarm.
        suspects: with an alarm, indices of the tests that may be the bad one, worst first; one when it is clear.
        names: with an alarm, the parameters in which the worst stands apart, worst first.
        z: for each of them, how many standard deviations, given all the other values but those named before it.
        looks: how many looks were taken.
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


def verdict(estimates: Sequence[Estimate]) -> Verdict:
    """Whether the tests agree; when not, which may be bad."""
    owner, names, residual, precision = _residual_system(estimates)
    tests = [_log_chance(residual, precision, np.flatnonzero(owner == i)) for i in range(len(estimates))]
    single, judged = _log_chances_of_each(residual, precision)
    looks = sum(rank > 0 for _, rank in tests) + int(np.count_nonzero(judged))
    if looks == 0:
        return Verdict(1.0, (), (), (), 0)
    # a test is as suspect as its most telling look
    worst = np.array([min([tests[i][0], *single[owner == i].tolist()]) for i in range(len(estimates))])
    order = np.argsort(worst)
    p = min(1.0, looks * float(np.exp(max(worst[order[0]], -700.0))))
    if p >= ALARM:
        return Verdict(p, (), (), (), looks)
    near = [int(i) for i in order if 2 * (worst[i] - worst[order[0]]) < _CLEARLY and worst[i] < np.log(ALARM / looks)]
    apart, z = _apart(np.flatnonzero(owner == order[0]), residual, precision, float(np.log(ALARM / looks)))
    return Verdict(p, tuple(near), tuple(names[k] for k in apart), tuple(z), looks)


def _residual_system(estimates: Sequence[Estimate]) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Which test each value is of, its name, u and R; whitened so that each value has unit variance."""
    known = parameter_names(estimates)
    owner = np.concatenate([np.full(len(e.names), i) for i, e in enumerate(estimates)])
    names = [n for e in estimates for n in e.names]
    total = covariance_of_all(estimates)
    unit = np.sqrt(np.diag(total))
    middle = {n: np.median([e.value(n) for e in estimates if n in e.names]) for n in known}
    data = (np.concatenate([e.values for e in estimates]) - np.array([middle[n] for n in names])) / unit
    design = np.array([[float(n == m) for m in known] for n in names]) / unit[:, None]
    inverse = np.linalg.inv(total / np.outer(unit, unit))
    scale = np.linalg.norm(design, axis=0)
    pull = (design / scale).T @ inverse
    precision = inverse - pull.T @ np.linalg.solve(pull @ (design / scale), pull)
    return owner, names, precision @ data, 0.5 * (precision + precision.T)


def covariance_of_all(estimates: Sequence[Estimate]) -> np.ndarray:
    """Covariance of all tests' values one below the other: gains common to all, clock lines each log's own.

    The line of a device's clock is fitted anew in every log: its error need not be the same, and is not cancelled
    between them. Each value gets a twentieth of its total uncertainty besides: where a shared error is nearly all of
    it, tests may differ by far less than the result is uncertain by, and no alarm is due.
    """
    edges = np.cumsum([0, *(len(e.names) for e in estimates)])
    total = np.zeros((edges[-1], edges[-1]))
    for estimate, begin in zip(estimates, edges, strict=False):
        here = slice(begin, begin + len(estimate.names))
        total[here, here] += estimate.covariance
        total[here, here] += sum(np.outer(v, v) for s, v in estimate.shared.items() if s.startswith("clock"))
    for label in {s for e in estimates for s in e.shared if not s.startswith("clock")}:
        shift = np.concatenate([e.shared.get(label, np.zeros(len(e.names))) for e in estimates])
        total += np.outer(shift, shift)
    return total + np.diag(_OF_NO_MATTER**2 * np.diag(total))


def _apart(of: np.ndarray, residual: np.ndarray, precision: np.ndarray, limit: float) -> tuple[list[int], list[float]]:
    """Which values of a test stand apart, one after the other: correlated good ones seem to as long as a bad is in."""
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
    """ln of the chance that leaving these values out mends as much as it does, and the degrees of freedom."""
    mended, rank = _mended(residual, precision, of)
    return (_log_tail(mended, rank) if rank else 0.0), rank


def _log_chances_of_each(residual: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for every value alone, shape (m,), and which of them anything else speaks of."""
    own = np.diag(precision)
    judged = own > _RANK
    mended = np.where(judged, residual**2 / np.where(judged, own, 1.0), 0.0)
    near = np.log(np.maximum(chdtrc(1, np.minimum(mended, _FAR_OUT)), 1e-300))
    half = 0.5 * np.maximum(mended, 1.0)
    far = -half - 0.5 * np.log(half) - gammaln(0.5)
    return np.where(mended > _FAR_OUT, far, near), judged


def _mended(residual: np.ndarray, precision: np.ndarray, of: np.ndarray) -> tuple[float, int]:
    """ΔQ of a set of values, and its degrees of freedom."""
    if not len(of):
        return 0.0, 0
    size, vectors = np.linalg.eigh(precision[np.ix_(of, of)])
    # a value that nothing else speaks of has no residual information
    kept = size > _RANK * max(1.0, float(size[-1]))
    return float(np.sum((vectors[:, kept].T @ residual[of]) ** 2 / size[kept])), int(np.count_nonzero(kept))


def _log_tail(chi2: float, dof: int) -> float:
    """ln P(χ² of dof > chi2), also where P itself underflows (leading term)."""
    if chi2 > _FAR_OUT:
        half = 0.5 * chi2
        return float(-half + (0.5 * dof - 1) * np.log(half) - gammaln(0.5 * dof))
    return float(np.log(chdtrc(dof, max(chi2, 0.0))))
