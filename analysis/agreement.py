"""Agreement of measurement and model: one statistic per point, one over all points, one per single cause.

The chance of a false alarm is 5 % of campaigns without any fault. Three questions share it: whether any single cause
(a parameter, a mass, a zero, a gain) would explain a significant part (4 %), whether any single point or release
deviates significantly (0.5 % over all of them), and whether all points together deviate (0.5 %). The first question is
the most sensitive to the usual faults of a rig. The other two need no list of causes. The causes share their 4 % by
evidence with the prior that ranks the explanations. A cause whose standard uncertainty is 10⁴ times the resolution of
the points needs a larger |z| than one whose uncertainty is close to that resolution.
Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincc, voigt_profile

from analysis.causes import Cause
from analysis.differences import Differences
from rig_basics.arrays import Array

CAUSES_LEVEL, POINTS_LEVEL, TOGETHER_LEVEL = 0.04, 0.005, 0.005
_DRAWS, _SEED = 20_000, 1
_SIZES = np.linspace(0.0, 15.0, 1501)
"""|z| at which the evidence is tabulated."""


@dataclass(frozen=True)
class Statistic:
    """χ² of some rows, its degrees of freedom and the probability that chance exceeds it."""

    chi2: float
    dof: int
    p: float

    @classmethod
    def of(cls, differences: Differences) -> Statistic:
        """Return the statistic of all rows of the differences."""
        chi2, dof = differences.chi2, len(differences.values)
        return cls(chi2, dof, float(gammaincc(0.5 * dof, 0.5 * chi2)) if dof else math.nan)

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {"chi2": self.chi2, "dof": self.dof, "p": self.p if math.isfinite(self.p) else None}


@dataclass(frozen=True)
class Agreement:
    """Agreement of the points with the model.

    Attributes:
        together: statistic of all rows of all compared points.
        points: statistic of each point's rows: "A" for its steady state, "A release" for the motion right after its
            release.
        point_limit: p below which a point fails.
        cause_z: cause → its best size divided by the standard deviation with which the points show it; 0 if a
            one-sided cause would have to be negative.
        words: cause → its description for a reader.
        cause_limits: cause → |cause_z| above which the cause is significant. Chance exceeds any of them in
            CAUSES_LEVEL of campaigns.
    """

    together: Statistic
    points: Mapping[str, Statistic]
    point_limit: float
    cause_z: Mapping[str, float]
    words: Mapping[str, str]
    cause_limits: Mapping[str, float]

    @property
    def failing_points(self) -> tuple[str, ...]:
        """Points whose own p is below the limit."""
        return tuple(name for name, found in self.points.items() if found.p < self.point_limit)

    @property
    def significant_causes(self) -> tuple[str, ...]:
        """Causes that explain more than chance does, the most significant first."""
        beyond = {name: z**2 - self.cause_limits[name] ** 2 for name, z in self.cause_z.items()}
        return tuple(sorted((name for name in beyond if beyond[name] > 0), key=lambda name: -beyond[name]))

    @property
    def passed(self) -> bool:
        """Whether all three questions are answered without an alarm."""
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
        """Return plain values."""
        return {
            "passed": self.passed,
            "why": self.why,
            **self.together.to_json(),
            "points": {name: found.to_json() for name, found in self.points.items()},
            "point_limit_p": self.point_limit,
            "cause_z": dict(self.cause_z),
            "cause_limits_z": dict(self.cause_limits),
        }


def agreement(differences: Differences, causes: Sequence[Cause]) -> Agreement:
    """Test all rows against the model.

    Args:
        differences: differences of all compared points.
        causes: causes that are tested one at a time.
    """
    points = {name: Statistic.of(differences.of(at)) for name, at in differences.groups.items()}
    words = {cause.name: cause.words for cause in causes}
    statistics = cause_statistics(differences, {cause.name: cause.direction for cause in causes})
    own = {cause.name: cause for cause in causes if cause.name in statistics.z}
    widths = [own[name].std / statistics.stds[name] for name in statistics.z]
    limits = limits_by_chance(statistics.correlation, widths, [own[name].one_sided for name in statistics.z])
    z = {name: max(0.0, value) if own[name].one_sided else value for name, value in statistics.z.items()}
    level = POINTS_LEVEL / max(1, len(points))
    named = dict(zip(z, limits.tolist(), strict=True))
    return Agreement(Statistic.of(differences), points, level, z, words, named)


@dataclass(frozen=True)
class CauseStatistics:
    """Fit of every cause alone.

    Attributes:
        z: cause → its best size divided by its standard deviation.
        stds: cause → that standard deviation, in the cause's unit.
        correlation: correlation of the z, shape (k, k).
    """

    z: Mapping[str, float]
    stds: Mapping[str, float]
    correlation: Array


def cause_statistics(differences: Differences, directions: Mapping[str, Array]) -> CauseStatistics:
    """Fit every cause alone. Causes that do not change the rows are left out.

    Args:
        directions: cause → change of the rows per unit of the cause, shape (m,).
    """
    units, stds = list[Array](), dict[str, float]()
    for name, direction in directions.items():
        white = differences.whitener @ direction
        length = float(np.linalg.norm(white))
        if length > 0 and math.isfinite(length):
            stds[name] = 1 / length
            units.append(white / length)
    shown = np.stack(units) if units else np.empty((0, len(differences.values)))
    z = shown @ (differences.whitener @ differences.values)
    return CauseStatistics(dict(zip(stds, z.tolist(), strict=True)), stds, shown @ shown.T)


def evidence(z: ArrayLike, width: float) -> Array:
    """Return the logarithm of the likelihood ratio of a statistic: with the cause over without it.

    With the cause, its size in standard deviations of the points has a Cauchy distribution about 0. z scatters about
    that size by a standard normal distribution and therefore has a Voigt distribution.

    Args:
        z: best size of the cause over its standard deviation by the points, any shape.
        width: scale of the Cauchy distribution: standard uncertainty of the cause over the same standard deviation.
    """
    z = np.asarray(z, float)
    density = np.asarray(voigt_profile(z, 1.0, width), float)
    return np.log(density) + 0.5 * z**2 + 0.5 * math.log(2 * math.pi)


def limits_by_chance(
    correlation: Array, widths: Sequence[float], one_sided: Sequence[bool] = (), level: float = CAUSES_LEVEL
) -> Array:
    """Return the |z| of each cause at the evidence that the largest evidence of all causes exceeds by chance.

    The distribution of the largest evidence is drawn (_DRAWS draws).

    Args:
        correlation: correlation of the statistics, shape (k, k).
        widths: standard uncertainty of each cause over its standard deviation by the points.
        one_sided: for each cause, whether only sizes above 0 count; empty if all causes are two-sided.
        level: probability that chance exceeds the limit.
    Returns:
        Shape (k,).
    """
    if not len(correlation):
        return np.empty(0)
    sizes, turn = np.linalg.eigh(correlation)
    root = turn * np.sqrt(np.maximum(sizes, 0.0))
    drawn = np.random.default_rng(_SEED).standard_normal((_DRAWS, len(root))) @ root.T
    seen = np.where(np.asarray(one_sided, bool), drawn, np.abs(drawn)) if len(one_sided) else np.abs(drawn)
    tables = [evidence(_SIZES, width) for width in widths]
    each: list[Array] = [np.interp(z, _SIZES, table) for z, table in zip(seen.T, tables, strict=True)]
    limit = float(np.quantile(np.max(each, axis=0), 1 - level))
    return np.array([float(np.interp(limit, table, _SIZES)) for table in tables])
