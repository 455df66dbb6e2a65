# pyright: strict
"""Whether measurement and model agree: one statistic per point, one over all points, one per single cause.

Three questions share the chance of a false alarm, 5 % of campaigns with nothing wrong: whether any single cause
(a parameter, a mass, a zero, a gain) would explain a significant part (4 %), whether any one point or release stands
out (0.5 % over all of them), and whether all of them together do (0.5 %). The first is the sharpest against what a rig
is usually wrong in; the others need no list of causes. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc  # pyright: ignore[reportMissingTypeStubs]

from analysis.causes import Cause
from analysis.differences import Differences

Array = NDArray[np.float64]

CAUSES_LEVEL, POINTS_LEVEL, TOGETHER_LEVEL = 0.04, 0.005, 0.005
_DRAWS, _SEED = 20_000, 1


@dataclass(frozen=True)
class Statistic:
    """χ² of some rows, its degrees of freedom and how often chance reaches it."""

    chi2: float
    dof: int
    p: float

    @classmethod
    def of(cls, differences: Differences) -> Statistic:
        """Of all rows of the differences."""
        chi2, dof = differences.chi2, len(differences.values)
        return cls(chi2, dof, float(gammaincc(0.5 * dof, 0.5 * chi2)) if dof else math.nan)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"chi2": self.chi2, "dof": self.dof, "p": self.p if math.isfinite(self.p) else None}


@dataclass(frozen=True)
class Agreement:
    """How far the points agree with the model.

    Attributes:
        together: of all rows of all points that could be compared.
        points: of each point's rows: "A" of its steady state, "A release" of what happened right after its release.
        point_limit: the p below which a point fails.
        cause_z: cause → its best size in standard deviations of what the points would show of it; 0 for a cause that
            cannot be below 0 and would have to be.
        words: cause → what it is, for a reader.
        cause_limit: the largest |cause_z| of all causes that chance reaches in CAUSES_LEVEL of campaigns.
    """

    together: Statistic
    points: Mapping[str, Statistic]
    point_limit: float
    cause_z: Mapping[str, float]
    words: Mapping[str, str]
    cause_limit: float

    @property
    def failing_points(self) -> tuple[str, ...]:
        """Points that stand out by themselves."""
        return tuple(name for name, found in self.points.items() if found.p < self.point_limit)

    @property
    def significant_causes(self) -> tuple[str, ...]:
        """Causes that would explain more than chance does, the most first."""
        found = [name for name, z in self.cause_z.items() if abs(z) > self.cause_limit]
        return tuple(sorted(found, key=lambda name: -abs(self.cause_z[name])))

    @property
    def passed(self) -> bool:
        """Whether none of the three questions is answered with an alarm."""
        return not (self.failing_points or self.significant_causes or self.together.p < TOGETHER_LEVEL)

    @property
    def why(self) -> str:
        """The reason in one sentence."""
        whole = f"χ² {self.together.chi2:.3g} on {self.together.dof}, p = {self.together.p:.2g}"
        if self.passed:
            return f"all points together agree with the model: {whole}"
        alarms: list[str] = []
        if self.together.p < TOGETHER_LEVEL:
            alarms.append("all points together differ from the model")
        if self.failing_points:
            alarms.append(f"point {', '.join(self.failing_points)} differs")
        if causes := self.significant_causes:
            alarms.append(f"a single cause would explain more than chance does: {self.words[causes[0]]}")
        return f"{'; '.join(alarms)}: {whole}"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "passed": self.passed, "why": self.why, **self.together.to_json(),
            "points": {name: found.to_json() for name, found in self.points.items()},
            "point_limit_p": self.point_limit,
            "cause_z": dict(self.cause_z), "cause_limit_z": self.cause_limit,
        }  # fmt: skip


def agreement(differences: Differences, causes: Sequence[Cause]) -> Agreement:
    """How far all rows agree with the model.

    Args:
        differences: of every point that was compared.
        causes: of which one alone may be significant.
    """
    points = {name: Statistic.of(differences.of(at)) for name, at in differences.groups.items()}
    z, correlation = cause_statistics(differences, {cause.name: cause.direction for cause in causes})
    words = {cause.name: cause.words for cause in causes}
    positive = {cause.name for cause in causes if cause.one_sided}
    limit = largest_by_chance(correlation, [name in positive for name in z])
    z = {name: max(0.0, value) if name in positive else value for name, value in z.items()}
    return Agreement(Statistic.of(differences), points, POINTS_LEVEL / max(1, len(points)), z, words, limit)


def cause_statistics(differences: Differences, directions: Mapping[str, Array]) -> tuple[dict[str, float], Array]:
    """Best size of each cause alone over its standard deviation, and these statistics' correlation, shape (k, k)."""
    shown: dict[str, Array] = {}
    for name, direction in directions.items():
        white = differences.whitener @ direction
        length = float(np.linalg.norm(white))
        if length > 0 and math.isfinite(length):
            shown[name] = white / length
    if not shown:
        return {}, np.empty((0, 0))
    units = np.stack(list(shown.values()))
    z = units @ (differences.whitener @ differences.values)
    return dict(zip(shown, z.tolist(), strict=True)), units @ units.T


def largest_by_chance(correlation: Array, one_sided: Sequence[bool] = (), level: float = CAUSES_LEVEL) -> float:
    """The largest |z| of all causes that chance exceeds with a probability, from draws; inf without causes.

    Args:
        correlation: of the statistics, shape (k, k).
        one_sided: for each, whether only sizes above 0 count; none where empty.
        level: the probability.
    """
    if not len(correlation):
        return math.inf
    sizes, turn = np.linalg.eigh(correlation)
    root = turn * np.sqrt(np.maximum(sizes, 0.0))
    drawn = np.random.default_rng(_SEED).standard_normal((_DRAWS, len(root))) @ root.T
    seen = np.where(np.asarray(one_sided, bool), drawn, np.abs(drawn)) if len(one_sided) else np.abs(drawn)
    return float(np.quantile(np.max(seen, axis=1), 1 - level))
