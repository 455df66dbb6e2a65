# pyright: strict
"""The smallest deviation of each cause that a point alone would notice: "D would see 0.4 % of k2"."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.causes import Cause
from analysis.differences import Differences

AT = 3.0
"""Standard deviations at which a deviation counts as noticed."""


@dataclass(frozen=True)
class Noticed:
    """One cause.

    Attributes:
        cause: what would be off.
        sizes: point → the smallest size that it alone would notice, in the cause's unit; inf where it shows none.
        together: the smallest size that all points together would notice.
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
        """In words."""
        size = self.sizes[self.point] * self.cause.factor
        return f"{self.point} would see {size:.2g} {self.cause.unit} of {self.cause.words}"

    def to_json(self) -> dict[str, Any]:
        """Plain values; sizes in the unit that is given with them, None where a point shows none."""
        sizes = {n: v * self.cause.factor if math.isfinite(v) else None for n, v in self.sizes.items()}
        together = self.together * self.cause.factor
        return {
            "cause": self.cause.name,
            "words": self.cause.words,
            "unit": self.cause.unit,
            "points": sizes,
            "together": together if math.isfinite(together) else None,
        }


def noticed(differences: Differences, causes: Sequence[Cause]) -> tuple[Noticed, ...]:
    """What each point alone, and all together, would notice of each cause.

    Args:
        differences: of all points.
        causes: with directions over the same rows.
    """
    at = differences.groups
    names = tuple(at)
    parts = {name: differences.of(rows) for name, rows in at.items()}

    def size(part: Differences, rows: list[int], cause: Cause) -> float:
        length = float(np.linalg.norm(part.whitener @ cause.direction[rows]))
        return AT / length if length > 0 else math.inf

    everything = list(range(len(differences.rows)))
    return tuple(
        Noticed(c, {n: size(parts[n], at[n], c) for n in names}, size(differences, everything, c)) for c in causes
    )
