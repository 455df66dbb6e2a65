# pyright: strict
"""Why points fail: each cause refitted alone and in pairs to all points, ranked by what it leaves and by its prior.

A cause of unknown size δ along direction d mends χ² by (dᵀC⁻¹r)²/(dᵀC⁻¹d). Its prior is a Cauchy distribution about 0
with the cause's own standard uncertainty as scale, so that of two causes that explain alike the one that is less far
off for itself comes first, and one that is far off is not ruled out. Ranked is by the likelihood integrated over the
prior: a cause that may have any of a thousand sizes the points tell apart has a thousandth of it for the one that fits.
A large size is found by predicting anew with it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.agreement import evidence
from analysis.causes import Cause
from analysis.differences import Differences

Array = NDArray[np.float64]
Again = Callable[[str, float], Differences | None]
"""(cause, its value) ↦ the differences with it; None where it cannot be predicted."""
Turned = Callable[[str, complex], Differences | None]
"""("run-out" or "bow", how much more of it in the rotor's frame, m) ↦ the differences with it; None as above."""

_SHOWN, _FOLLOWED, _ROUNDS = 5, 4, 6
_FAR = 8.0  # standard deviations of the points from which a linear size is predicted anew
_NEAR = 0.02  # of its own standard deviation: the size has settled
_PARALLEL = 0.999  # correlation of two causes that the points do not tell apart
_WORTH_A_SECOND = 12.0  # χ² that another cause must mend beside the first


@dataclass(frozen=True)
class Explanation:
    """One or two causes that would explain the differences.

    Attributes:
        causes: one, or two together.
        sizes: how far the truth is above what was taken, in each cause's unit.
        stds: their standard uncertainties by the points.
        chi2: what is left with them.
        score: χ² without any cause less twice the logarithm of the evidence for these; the smaller the likelier.
        explained: whether what is left is what chance leaves.
    """

    causes: tuple[Cause, ...]
    sizes: tuple[float, ...]
    stds: tuple[float, ...]
    chi2: float
    score: float
    explained: bool

    @property
    def possible(self) -> bool:
        """Whether no cause that cannot be below 0 is."""
        return all(size > 0 or not cause.one_sided for cause, size in zip(self.causes, self.sizes, strict=True))

    def sentence(self, before: float) -> str:
        """In words, with χ² before and after."""
        parts = [c.sized(size, std) for c, size, std in zip(self.causes, self.sizes, self.stds, strict=True)]
        return f"{' and '.join(parts)}: χ² {before:.3g} → {self.chi2:.3g}"

    def to_json(self) -> dict[str, Any]:
        """Plain values; sizes in the unit that is given with them."""
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
    """All that would explain the differences, the likeliest first.

    Attributes:
        chi2, dof: of the differences as they are.
        singles: one cause each.
        pairs: two causes each, where one alone leaves too much.
    """

    chi2: float
    dof: int
    singles: tuple[Explanation, ...]
    pairs: tuple[Explanation, ...]

    @property
    def best(self) -> Explanation | None:
        """The likeliest that leaves no more than chance, one cause before two; None where nothing explains it."""
        return next((e for e in (*self.singles, *self.pairs) if e.explained), None)

    @property
    def sentences(self) -> list[str]:
        """For a reader, the likeliest first."""
        if not self.singles:
            return []
        likely = [e for e in (*self.singles, *self.pairs) if e.explained][:3]
        if not likely:
            nearest = min((*self.singles, *self.pairs), key=lambda e: e.chi2)
            return [
                f"no single cause and no pair of causes explains the differences; the nearest is "
                f"{nearest.sentence(self.chi2)}"
            ]
        first, *others = likely
        settles = " or ".join(dict.fromkeys(cause.settles for cause in first.causes))
        text = [f"best explanation: {first.sentence(self.chi2)}. What settles it: {settles}"]
        # without evidence for it a cause is not worth a line, though it came next
        return text + [f"next: {other.sentence(self.chi2)}" for other in others if other.score < self.chi2]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "chi2": self.chi2,
            "dof": self.dof,
            "singles": [e.to_json() for e in self.singles[:_SHOWN]],
            "pairs": [e.to_json() for e in self.pairs[:_SHOWN]],
            "sentences": self.sentences,
        }


def explanations(
    differences: Differences, found: Sequence[Cause], again: Again | None = None, turned: Turned | None = None
) -> Explanations:
    """Every cause and pair of causes fitted to all rows.

    Args:
        differences: of all points.
        found: the causes.
        again: predicts with a cause at another value; None takes every cause for small.
        turned: the same for a slow roll, whose two components are one cause.
    """
    chi2, dof = differences.chi2, len(differences.values)
    limit = _left_by_chance(dof)
    alone = [_fitted(differences, (c,), limit) for c in found]
    singles = sorted((e for e in alone if e.possible), key=lambda e: e.score)
    if again is not None:
        # friction changes what may be left of the points, too, so where releases show it it is always tried
        singles = [
            _followed(differences, e, again, limit) if k < _FOLLOWED or e.causes[0].one_sided else e
            for k, e in enumerate(singles)
        ]
        singles.sort(key=lambda e: e.score)
    pairs: list[Explanation] = []
    if singles and not singles[0].explained:
        pairs = [
            _fitted(differences, pair, limit) for pair in itertools.combinations(found, 2) if _apart(differences, pair)
        ]
        if turned is not None:
            for kind in ("run-out", "bow"):
                pairs = _with_vector(differences, kind, found, pairs, turned, limit)
        pairs.sort(key=lambda e: e.score)
        pairs = [e for e in pairs if e.possible and e.chi2 < singles[0].chi2 - _WORTH_A_SECOND]
    return Explanations(chi2, dof, tuple(singles), tuple(pairs[:_SHOWN]))


def _left_by_chance(dof: int) -> float:
    """χ² that chance exceeds once in a thousand times, by Wilson and Hilferty."""
    share = 2 / (9 * max(dof, 1))
    return max(dof, 1) * (1 - share + 3.09 * math.sqrt(share)) ** 3


def _fitted(
    differences: Differences, causes: tuple[Cause, ...], limit: float, beyond: Sequence[float] = (0.0,)
) -> Explanation:
    """Causes fitted to rows that were predicted with sizes `beyond` of them."""
    design = differences.whitener @ np.stack([cause.direction for cause in causes], axis=1)
    white = differences.whitener @ differences.values
    normal = design.T @ design
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    sizes = inverse @ (design.T @ white)
    left = white - design @ sizes
    return _explanation(causes, sizes + np.array(beyond), inverse, float(left @ left), limit)


def _explanation(causes: tuple[Cause, ...], sizes: Array, covariance: Array, chi2: float, limit: float) -> Explanation:
    """An explanation with the score of the sizes' prior: of two, their volume is less by their correlation."""
    stds = np.sqrt(np.diag(covariance))
    score = chi2
    for cause, size, std in zip(causes, sizes, stds, strict=True):
        if std > 0:  # what the points do not show at all has no evidence
            score += float((size / std) ** 2 - 2 * evidence(size / std, cause.std / std))
    if len(causes) > 1:
        score -= float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1])
    return Explanation(causes, tuple(sizes.tolist()), tuple(stds.tolist()), chi2, score, chi2 < limit)


def _apart(differences: Differences, pair: tuple[Cause, ...]) -> bool:
    """Whether the points tell two causes apart."""
    a, b = (differences.whitener @ cause.direction for cause in pair)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and abs(float(a @ b)) < _PARALLEL * size


def _followed(differences: Differences, one: Explanation, again: Again, limit: float) -> Explanation:
    """A large size found by predicting anew until it settles; as it was where that is not possible.

    What is predicted anew has directions of its own, so the size is that of Gauss and Newton.
    """
    (cause,), (size,), (std,) = one.causes, one.sizes, one.stds
    if not math.isfinite(cause.value) or abs(size) < _FAR * std:
        return one
    best = one
    for _ in range(_ROUNDS):
        there = again(cause.name, cause.value + size)
        if there is None or there.rows != differences.rows:
            return best
        # at the new value, how much farther, with the direction there
        column = _direction_at(there, cause)
        unit = there.whitener @ column
        length = float(np.linalg.norm(unit))
        if not length > 0:
            return best
        step = float(unit @ (there.whitener @ there.values)) / length**2
        left = there.chi2 - (step * length) ** 2
        best = _explanation(one.causes, np.array([size + step]), np.array([[1 / length**2]]), max(left, 0.0), limit)
        size += step
        if abs(step) < _NEAR * std:
            break
    return best


def _direction_at(there: Differences, cause: Cause) -> Array:
    if cause.name in there.parameters:
        return -there.by_parameter[:, there.parameters.index(cause.name)]
    return cause.direction


def _with_vector(
    differences: Differences, kind: str, found: Sequence[Cause], pairs: list[Explanation], turned: Turned, limit: float
) -> list[Explanation]:
    """The pairs with that of a slow roll's components followed: a vector that is added to others of its size bends.

    Args:
        kind: how SLOW_ROLL begins.
    """
    own = tuple(cause for cause in found if cause.name.startswith(kind))
    if len(own) != 2:
        return pairs
    others = [e for e in pairs if e.causes != own]
    best = _fitted(differences, own, limit)
    for _ in range(_ROUNDS):
        there = turned(kind, complex(*best.sizes))
        if there is None:
            break
        left = _left_by_chance(len(there.values))  # a disk that no longer rests has other rows
        moved = tuple(replace(cause, direction=there.by_slow_roll[cause.name]) for cause in own)
        before, best = best, replace(_fitted(there, moved, left, best.sizes), causes=own)
        if np.all(np.abs(np.subtract(best.sizes, before.sizes)) < _NEAR * np.array(best.stds)):
            break
    return [*others, best]
