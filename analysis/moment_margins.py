"""Standard uncertainties of a rig's first mass moments and of its distance to the borders of its balancing region."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynamics.equations.balancing import IMPROPERLY_OVERSIZED, BalancingMargins, balancing_margins
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_configs import IdentifiedParameters, Rig


@dataclass(frozen=True)
class MomentMargins(Tabular):
    """A rig in its balancing region, with standard uncertainties.

    Attributes:
        moments_kg_m: S_A, S_B, S_P.
        std_kg_m: their standard uncertainties; 0 if the files contain none.
        margins: balancing region, and increase and decrease of S_P to its borders.
        grow_std_kg_m, shrink_std_kg_m: standard uncertainties of these distances, correlations of the moments included.
    """

    moments_kg_m: tuple[float, float, float]
    std_kg_m: tuple[float, float, float]
    margins: BalancingMargins
    grow_std_kg_m: float
    shrink_std_kg_m: float

    @property
    def heading(self) -> str:
        """Region of the pendulum set."""
        return f"MomentMargins: {self.margins.region}"

    def columns(self) -> Mapping[str, Column]:
        """Return the moments and the distances of S_P to its borders; NaN without a border."""
        distances = self.margins.may_grow_kg_m, self.margins.may_shrink_kg_m
        return {
            "quantity": ["S_A", "S_B", "S_P", "S_P may grow by", "S_P may shrink by"],
            "value_kg_m": [*self.moments_kg_m, *(math.nan if far is None else far for far in distances)],
            "std_kg_m": [*self.std_kg_m, self.grow_std_kg_m, self.shrink_std_kg_m],
        }


def moment_margins(rig: Rig, known: IdentifiedParameters) -> MomentMargins:
    """Return region and margins of a rig's imbalance.

    S_A and S_B have the rig file's uncertainties of masses and lengths, with the error that measurements by the same
    instrument share. S_P has the uncertainty of the identification if the parameters contain S_P, else the rig file's.

    Args:
        rig: rig file with the parameters applied.
        known: identified parameters; empty without any.
    """
    p = rig.physics
    moments = (p.a.first_moment_kg_m, p.b.first_moment_kg_m, p.imbalance_moment_kg_m)
    changes = [_change(rig, effects, "SP_kg_m" in known.values) for effects in _sources(rig)]
    by_radius = p.imbalance_mass_kg * rig.imbalance.assumed_radius_std_m
    alone = known.std["SP_kg_m"] if "SP_kg_m" in known.values else by_radius
    changes.append(np.array([0.0, 0.0, alone]))
    each = np.array(changes)
    margins = balancing_margins(*moments)
    heavier = 1.0 if moments[0] >= moments[1] else -1.0
    to_most = float(np.linalg.norm(each @ np.array([1.0, 1.0, -1.0])))
    to_least = float(np.linalg.norm(each @ np.array([heavier, -heavier, -1.0])))
    improper = margins.region == IMPROPERLY_OVERSIZED
    proper = margins.may_grow_kg_m is not None and not improper
    std = np.linalg.norm(each, axis=0).tolist()
    return MomentMargins(
        moments,
        (std[0], std[1], std[2]),
        margins,
        grow_std_kg_m=to_least if improper else to_most,
        shrink_std_kg_m=to_least if proper else to_most,
    )


def _sources(rig: Rig) -> list[dict[str, float]]:
    return [dict(source.effects) for source in rig.known.sources]


def _change(rig: Rig, effects: dict[str, float], found: bool) -> Array:
    """Return the change of S_A, S_B and S_P per standard deviation of a source, kg m; 0 for an identified S_P."""
    p = rig.physics
    pendulums = [
        q.length_m * effects.get(f"pendulums.{name}.mass_kg", 0.0)
        + q.mass_kg * effects.get(f"pendulums.{name}.length_m", 0.0)
        for name, q in (("a", p.a), ("b", p.b))
    ]
    own = 0.0 if found else p.imbalance_radius_m * effects.get("imbalance.mass_kg", 0.0)
    return np.array([*pendulums, own])


def probability_of_region(margin_kg_m: float | None, std_kg_m: float) -> float:
    """Return the normal probability that a border is not crossed; 1 without a border or without uncertainty."""
    if margin_kg_m is None or std_kg_m == 0:
        return 1.0
    return 0.5 * math.erfc(-margin_kg_m / std_kg_m / math.sqrt(2))
