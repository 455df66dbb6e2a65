# pyright: strict
"""What a rig takes as known, and how well: its physical numbers, their standard uncertainties, and what they share.

A number is a mass, a length or an angle that no test finds. A source is one independent cause of error: a number's own
uncertainty, or an instrument's, which moves everything that was measured with it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from dynamics.equations.parameters import RotorParameters
from rig_configs.table import Positive, Table

Kind = Literal["A", "B"]
Distribution = Literal["normal", "rectangular", "triangular", "arcsine", "t"]

ZERO_A, ZERO_B, INDEX = "encoders.a.zero_rad", "encoders.b.zero_rad", "phase.index_angle_rad"
NUMBERS: Mapping[str, str] = {
    "rotor.mass_kg": "kg",
    "imbalance.mass_kg": "kg",
    "pendulums.a.mass_kg": "kg",
    "pendulums.a.length_m": "m",
    "pendulums.b.mass_kg": "kg",
    "pendulums.b.length_m": "m",
    "pendulums.pivot_shift_m": "m",
    ZERO_A: "rad",
    ZERO_B: "rad",
    INDEX: "rad",
}
"""What no test finds, by its place in the rig file, with its unit. The imbalance's radius is none: S_P is found."""
MASSES = tuple(name for name, unit in NUMBERS.items() if unit == "kg")
PHYSICAL = tuple(name for name in NUMBERS if name not in (ZERO_A, ZERO_B, INDEX))
FRICTION = ("friction.a_Nm", "friction.b_Nm")
"""Dry friction of A and B at the speed of a release, N m: no number of the rig file, taken as 0 where none is found."""
CONTACT_FRICTION = ("friction.a_kg_m2", "friction.b_kg_m2")
"""The same as one that goes with the contact force: torque per square of the speed."""
KEPT_FRICTION = ("coulomb_a_Nm", "coulomb_b_Nm", "contact_a_kg_m2", "contact_b_kg_m2")
"""Dry friction as parameters.toml keeps it: a torque of A and B at any speed, and one per square of the speed."""
DRAG = ("drag.a_Nms2_per_rad2", "drag.b_Nms2_per_rad2")
"""The air's torque on A and B over the square of the speed relative to the rotor; 0 where none is found."""
LABEL = "known"
"""Begin of the labels under which a source's errors are kept in estimates."""


def gain_label(axis: str) -> str:
    """Under which errors of the displacement's gain along an axis are kept."""
    return f"gain {axis}"


def known_label(name: str) -> str:
    """Under which errors of a source are kept, by the number's or the instrument's name."""
    return f"{LABEL} {name}"


class Instrument(Table):
    """What several numbers were measured with: a balance, a caliper.

    relative_std is its scale's relative standard uncertainty, one error in all that it measured; type, distribution
    and degrees of freedom are those of that scale and of each number's own uncertainty.
    """

    measures: Annotated[list[str], Field(min_length=1)]
    relative_std: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    type: Kind = "B"
    distribution: Distribution = "normal"
    degrees_of_freedom: Positive | None = None


@dataclass(frozen=True)
class KnownSource:
    """One independent cause of error in what is taken as known.

    Attributes:
        name: the number's place in the rig file, or the instrument's name.
        std: its standard uncertainty: in the number's unit, or relative for an instrument.
        unit: of `std`; "1" for an instrument.
        effects: number → its change for one standard deviation of this source, in the number's unit.
        kind, distribution, degrees_of_freedom: as GUM 4.2 and 4.3 have them.
    """

    name: str
    std: float
    unit: str
    effects: Mapping[str, float]
    kind: Kind = "B"
    distribution: Distribution = "normal"
    degrees_of_freedom: float = math.inf

    @property
    def label(self) -> str:
        """Under which its errors are kept in estimates."""
        return known_label(self.name)


@dataclass(frozen=True)
class Known:
    """All numbers a rig takes as known.

    Attributes:
        values: every number, in the order of NUMBERS.
        sources: causes of error with a standard uncertainty above 0.
    """

    values: Mapping[str, float]
    sources: tuple[KnownSource, ...] = field(default=())

    @property
    def exact(self) -> tuple[str, ...]:
        """Physical numbers that are not 0 and have no uncertainty."""
        moved = {name for source in self.sources for name in source.effects}
        return tuple(name for name in PHYSICAL if name not in moved and self.values.get(name, 0.0) != 0.0)

    def std(self, name: str) -> float:
        """Standard uncertainty of a number, all of its sources together."""
        return math.hypot(*(source.effects.get(name, 0.0) for source in self.sources))


def physical_numbers(physics: RotorParameters) -> dict[str, float]:
    """The physical numbers that no test finds, by name."""
    return {
        "rotor.mass_kg": physics.rotor_mass_kg,
        "imbalance.mass_kg": physics.imbalance_mass_kg,
        "pendulums.a.mass_kg": physics.a.mass_kg,
        "pendulums.a.length_m": physics.a.length_m,
        "pendulums.b.mass_kg": physics.b.mass_kg,
        "pendulums.b.length_m": physics.b.length_m,
        "pendulums.pivot_shift_m": physics.pivot_shift_m,
    }


def with_number(physics: RotorParameters, name: str, value: float) -> RotorParameters:
    """The rig with one physical number changed, and the seven parameters that tests find as they were.

    Args:
        name: of PHYSICAL.
        value: in its unit.
    Raises:
        OutsideDomain: no rig has it.
    """
    found = physics.identified()
    part, _, key = name.removeprefix("pendulums.").partition(".")
    if part in ("a", "b"):
        pendulum = dataclasses.replace(physics.a if part == "a" else physics.b, **{key: value})
        return dataclasses.replace(physics, **{part: pendulum})
    if part == "pivot_shift_m":
        return dataclasses.replace(physics, pivot_shift_m=value)
    changed = dataclasses.replace(physics, **{f"{part}_{key}": value})
    return changed.with_values(SP_kg_m=found["SP_kg_m"]) if part == "imbalance" and value > 0 else changed


def own_source(name: str, std: float, instrument: Instrument | None, places: tuple[str, ...] = ()) -> KnownSource:
    """A number's own uncertainty.

    Args:
        places: the numbers it moves alike; its own name where none is given.
    """
    effects = dict.fromkeys(places or (name,), std)
    if instrument is None:
        return KnownSource(name, std, NUMBERS[(places or (name,))[0]], effects)
    freedom = math.inf if instrument.degrees_of_freedom is None else instrument.degrees_of_freedom
    return KnownSource(name, std, NUMBERS[name], effects, instrument.type, instrument.distribution, freedom)


def scale_source(name: str, instrument: Instrument, values: Mapping[str, float]) -> KnownSource | None:
    """An instrument's scale error; None where it has none or moves nothing."""
    effects = {n: instrument.relative_std * values[n] for n in instrument.measures if values.get(n)}
    if not instrument.relative_std or not effects:
        return None
    freedom = math.inf if instrument.degrees_of_freedom is None else instrument.degrees_of_freedom
    return KnownSource(name, instrument.relative_std, "1", effects, instrument.type, instrument.distribution, freedom)
