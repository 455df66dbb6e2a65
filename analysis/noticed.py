"""Smallest deviation of each cause that a single point would detect: "D would see 0.4 % of k2"."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.causes import Cause
from analysis.differences import Differences

AT = 3.0
"""Standard deviations at which a deviation counts as detected."""


@dataclass(frozen=True)
class DetectableSizes:
    """Detectable sizes of one cause.

    Attributes:
        cause: the cause.
        sizes: point → smallest size that it alone would detect, in the cause's unit; inf if the point is insensitive.
        together: smallest size that all points together would detect.
    """

    cause: Cause
    sizes: Mapping[str, float]
    together: float

    @property
    def point(self) -> str:
        """The most sensitive point."""
        return min(self.sizes, key=lambda name: self.sizes[name])

    @property
    def sentence(self) -> str:
        """Sentence about the most sensitive point."""
        size = self.sizes[self.point] * self.cause.factor
        return f"{self.point} would see {size:.2g} {self.cause.unit} of {self.cause.words}"

    def to_json(self) -> dict[str, Any]:
        """Return plain values; sizes in the unit given with them, None if a point is insensitive."""
        sizes = {n: v * self.cause.factor if math.isfinite(v) else None for n, v in self.sizes.items()}
        together = self.together * self.cause.factor
        return {
            "cause": self.cause.name,
            "words": self.cause.words,
            "unit": self.cause.unit,
            "points": sizes,
            "together": together if math.isfinite(together) else None,
        }


def noticed(differences: Differences, causes: Sequence[Cause]) -> tuple[DetectableSizes, ...]:
    """Return the sizes of each cause that each point alone and all points together would detect.

    Args:
        differences: differences of all points.
        causes: causes with directions over the same rows.
    """
    at = differences.groups
    names = tuple(at)
    parts = {name: differences.of(rows) for name, rows in at.items()}

    def size(part: Differences, rows: list[int], cause: Cause) -> float:
        length = float(np.linalg.norm(part.whitener @ cause.direction[rows]))
        return AT / length if length > 0 else math.inf

    everything = list(range(len(differences.rows)))
    return tuple(
        DetectableSizes(c, {n: size(parts[n], at[n], c) for n in names}, size(differences, everything, c))
        for c in causes
    )
