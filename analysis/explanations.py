"""Explanations of failing points: causes fitted alone and in pairs to all points, ranked by evidence.

A cause of unknown size δ along direction d reduces χ² by (dᵀC⁻¹r)²/(dᵀC⁻¹d). Its prior is a Cauchy distribution about 0
whose scale is the standard uncertainty of the cause. Of two causes with equal fits the one with the smaller relative
deviation ranks first, and a cause with a large deviation is not excluded. The ranking uses the likelihood integrated
over the prior: a cause with a thousand distinguishable sizes has a thousandth of the weight at the size that fits.
A large size is found by repeated prediction with it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.agreement import evidence
from analysis.causes import Cause
from analysis.differences import Differences
from rig_basics.arrays import Array

Again = Callable[[str, float], Differences | None]
"""(cause, its value) ↦ the differences with it; None if they cannot be predicted."""
Turned = Callable[[str, complex], Differences | None]
"""("run-out" or "bow", its increase in the rotor's frame, m) ↦ the differences with it; None if not predictable."""

_MAX_SHOWN, _MAX_FOLLOWED, _MAX_ROUNDS = 5, 4, 6
_MAX_LINEAR_STD = 8.0  # linear size in standard deviations of the points above which the prediction is repeated
_MAX_LAST_STEP_STD = 0.02  # last step of a followed size, in its own standard deviations, at convergence
_MAX_CORRELATION = 0.999  # of two causes that the points can distinguish
_MAX_NEAREST_LEFT = 0.5  # of χ² above its expectation: a cause that leaves most of the differences is not near them
_MIN_CHI2_OF_SECOND = 12.0  # reduction of χ² by a pair below the best single cause


@dataclass(frozen=True)
class Explanation:
    """One or two causes that would explain the differences.

    Attributes:
        causes: one cause, or two together.
        sizes: true value minus value used, in each cause's unit.
        stds: standard uncertainties of the sizes by the points.
        chi2: χ² that remains with them.
        score: χ² without any cause minus twice the logarithm of the evidence for these; smaller is likelier.
        explained: whether the remaining χ² is within chance.
    """

    causes: tuple[Cause, ...]
    sizes: tuple[float, ...]
    stds: tuple[float, ...]
    chi2: float
    score: float
    explained: bool

    @property
    def possible(self) -> bool:
        """Whether every cause leaves a possible value: a mass, length, stiffness, gain or torque is positive."""
        return all(not cause.value + size <= 0 for cause, size in zip(self.causes, self.sizes, strict=True))

    def sentence(self, before: float) -> str:
        """Describe the causes with their sizes, and χ² before and after."""
        parts = [c.sized(size, std) for c, size, std in zip(self.causes, self.sizes, self.stds, strict=True)]
        return f"{' and '.join(parts)}: χ² {before:.3g} → {self.chi2:.3g}"

    def to_json(self) -> dict[str, Any]:
        """Return plain values; sizes in the unit given with them."""
        return {
            "causes": [
                {
                    "name": cause.name,
                    "size": size * cause.factor,
                    "std": std * cause.factor,
                    "unit": cause.unit,
                    "own_std": cause.std * cause.factor,
                    "settles": cause.settles,
                }
                for cause, size, std in zip(self.causes, self.sizes, self.stds, strict=True)
            ],
            "chi2": self.chi2,
            "score": self.score,
            "explained": self.explained,
        }


@dataclass(frozen=True)
class Explanations:
    """All explanations of the differences, the likeliest first.

    Attributes:
        chi2, dof: χ² and degrees of freedom of the differences without any cause.
        singles: explanations by one cause.
        pairs: explanations by two causes; empty if one cause suffices.
    """

    chi2: float
    dof: int
    singles: tuple[Explanation, ...]
    pairs: tuple[Explanation, ...]

    @property
    def best(self) -> Explanation | None:
        """The likeliest explanation within chance, one cause before two; None if no explanation suffices."""
        return next((e for e in (*self.singles, *self.pairs) if e.explained), None)

    @property
    def sentences(self) -> list[str]:
        """Sentences for a reader, the likeliest explanation first."""
        if not self.singles:
            return []
        likely = [e for e in (*self.singles, *self.pairs) if e.explained][:3]
        if not likely:
            nearest = min((*self.singles, *self.pairs), key=lambda e: e.chi2)
            none = "no single cause and no pair of causes explains the differences"
            if nearest.chi2 - self.dof > _MAX_NEAREST_LEFT * (self.chi2 - self.dof):
                return [f"{none}, nor most of them: χ² {self.chi2:.3g} on {self.dof}"]
            return [f"{none}; the nearest is {nearest.sentence(self.chi2)}"]
        first, *others = likely
        settles = " or ".join(dict.fromkeys(cause.settles for cause in first.causes))
        text = [f"best explanation: {first.sentence(self.chi2)}. What settles it: {settles}"]
        # a cause without evidence is not reported, even if it ranks next
        return text + [f"next: {other.sentence(self.chi2)}" for other in others if other.score < self.chi2]

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "chi2": self.chi2,
            "dof": self.dof,
            "singles": [e.to_json() for e in self.singles[:_MAX_SHOWN]],
            "pairs": [e.to_json() for e in self.pairs[:_MAX_SHOWN]],
            "sentences": self.sentences,
        }


def explanations(
    differences: Differences, found: Sequence[Cause], again: Again | None = None, turned: Turned | None = None
) -> Explanations:
    """Fit every cause and pair of causes to all rows.

    Args:
        differences: differences of all points.
        found: possible causes.
        again: predicts the differences with a cause at another value; None treats every cause as small.
        turned: the same for a slow roll, whose two components are one cause.
    """
    chi2, dof = differences.chi2, len(differences.values)
    limit = _left_by_chance(dof)
    found = [
        cause for cause in found if np.any(differences.whitener @ cause.direction)
    ]  # the points show the others not
    alone = [_fitted(differences, (c,), limit) for c in found]
    singles = sorted((e for e in alone if e.possible), key=lambda e: e.score)
    if again is not None:
        # friction also changes the remainder at the points, so it is always followed where releases show it
        singles = [
            _followed(differences, e, again, limit) if k < _MAX_FOLLOWED or e.causes[0].one_sided else e
            for k, e in enumerate(singles)
        ]
        singles = sorted((e for e in singles if e.possible), key=lambda e: e.score)
    pairs: list[Explanation] = []
    if singles and not singles[0].explained:
        pairs = [
            _fitted(differences, pair, limit) for pair in itertools.combinations(found, 2) if _apart(differences, pair)
        ]
        if turned is not None:
            for kind in ("run-out", "bow"):
                pairs = _with_vector(differences, kind, found, pairs, turned, limit)
        pairs.sort(key=lambda e: e.score)
        pairs = [e for e in pairs if e.possible and e.chi2 < singles[0].chi2 - _MIN_CHI2_OF_SECOND]
    return Explanations(chi2, dof, tuple(singles), tuple(pairs[:_MAX_SHOWN]))


def _left_by_chance(dof: int) -> float:
    """Return χ² that chance exceeds with probability 0.001, by the approximation of Wilson and Hilferty."""
    share = 2 / (9 * max(dof, 1))
    return max(dof, 1) * (1 - share + 3.09 * math.sqrt(share)) ** 3


def _fitted(
    differences: Differences, causes: tuple[Cause, ...], limit: float, beyond: Sequence[float] = (0.0,)
) -> Explanation:
    """Fit causes to rows that were predicted with sizes `beyond` of them."""
    design = differences.whitener @ np.stack([cause.direction for cause in causes], axis=1)
    white = differences.whitener @ differences.values
    normal = design.T @ design
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    sizes = inverse @ (design.T @ white)
    left = white - design @ sizes
    return _explanation(causes, sizes + np.array(beyond), inverse, float(left @ left), limit)


def _explanation(causes: tuple[Cause, ...], sizes: Array, covariance: Array, chi2: float, limit: float) -> Explanation:
    """Return an explanation with its score; the volume of two sizes is reduced by their correlation."""
    stds = np.sqrt(np.diag(covariance))
    score = chi2
    for cause, size, std in zip(causes, sizes, stds, strict=True):
        if std > 0:  # a cause that the points do not show has no evidence
            score += float((size / std) ** 2 - 2 * evidence(size / std, cause.std / std))
    if len(causes) > 1:
        score -= float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1])
    return Explanation(causes, tuple(sizes.tolist()), tuple(stds.tolist()), chi2, score, chi2 < limit)


def _apart(differences: Differences, pair: tuple[Cause, ...]) -> bool:
    """Whether the points can distinguish two causes."""
    a, b = (differences.whitener @ cause.direction for cause in pair)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and abs(float(a @ b)) < _MAX_CORRELATION * size


def _followed(differences: Differences, one: Explanation, again: Again, limit: float) -> Explanation:
    """Follow a large size by repeated prediction until it converges; return `one` where that is not possible.

    A repeated prediction has directions of its own, so the size is that of the Gauss–Newton method.
    """
    (cause,), (size,), (std,) = one.causes, one.sizes, one.stds
    if not math.isfinite(cause.value) or abs(size) < _MAX_LINEAR_STD * std:
        return one
    best = one
    for _ in range(_MAX_ROUNDS):
        there = again(cause.name, cause.value + size)
        if there is None or there.rows != differences.rows:
            return best
        # remaining step at the new value, along the direction there
        column = _direction_at(there, cause)
        unit = there.whitener @ column
        length = float(np.linalg.norm(unit))
        if not length > 0:
            return best
        step = float(unit @ (there.whitener @ there.values)) / length**2
        left = there.chi2 - (step * length) ** 2
        best = _explanation(one.causes, np.array([size + step]), np.array([[1 / length**2]]), max(left, 0.0), limit)
        size += step
        if abs(step) < _MAX_LAST_STEP_STD * std:
            break
    return best


def _direction_at(there: Differences, cause: Cause) -> Array:
    if cause.name in there.parameters:
        return -there.by_parameter[:, there.parameters.index(cause.name)]
    return cause.direction


def _with_vector(
    differences: Differences, kind: str, found: Sequence[Cause], pairs: list[Explanation], turned: Turned, limit: float
) -> list[Explanation]:
    """Return the pairs with that of a slow roll's two components followed: its effect as a vector sum is nonlinear.

    Args:
        kind: start of the names in SLOW_ROLL.
    """
    own = tuple(cause for cause in found if cause.name.startswith(kind))
    if len(own) != 2:
        return pairs
    others = [e for e in pairs if e.causes != own]
    best = _fitted(differences, own, limit)
    for _ in range(_MAX_ROUNDS):
        there = turned(kind, complex(*best.sizes))
        if there is None:
            break
        left = _left_by_chance(len(there.values))  # the rows change when the disk is no longer at rest
        moved = tuple(replace(cause, direction=there.by_slow_roll[cause.name]) for cause in own)
        before, best = best, replace(_fitted(there, moved, left, best.sizes), causes=own)
        if np.all(np.abs(np.subtract(best.sizes, before.sizes)) < _MAX_LAST_STEP_STD * np.array(best.stds)):
            break
    return [*others, best]
