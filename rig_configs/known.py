"""Known physical numbers of a rig, with their standard uncertainties and common sources of error.

A number is a mass, a length or an angle that no test identifies. A source is one independent cause of error: a number's
own uncertainty, or an instrument's, which affects everything that was measured with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from dynamics.equations.parameters import RotorParameters
from rig_configs.error_label import ErrorLabel
from rig_configs.physical_numbers import PHYSICAL_KEYS, PHYSICAL_NUMBERS
from rig_configs.table import Positive, RigTable

Kind = Literal["A", "B"]
Distribution = Literal["normal", "rectangular", "triangular", "arcsine", "t"]

ZERO_A, ZERO_B, INDEX = "encoders.a.zero_rad", "encoders.b.zero_rad", "phase.index_angle_rad"
USUAL_SHARE = 1e-3
"""Relative standard uncertainty of a mass or length that is stated without one: 1 g of 1 kg on a kitchen balance,
0.05 mm of 54 mm with a caliper."""
PHYSICAL = tuple(key for key in PHYSICAL_KEYS if PHYSICAL_NUMBERS[key].known)
"""Numbers of the equations that no test identifies, by key. S_P is identified, so its radius is not here."""
MASSES = tuple(key for key in PHYSICAL if PHYSICAL_NUMBERS[key].unit == "kg")
FRICTION = ("friction.a_Nm", "friction.b_Nm")
"""Dry friction of A and B at the speed of a release, N m; not in the rig file, 0 if none was identified."""
CONTACT_FRICTION = ("friction.a_kg_m2", "friction.b_kg_m2")
"""Dry friction of A and B by the contact force: torque per square of the speed."""
KEPT_FRICTION = ("coulomb_a_Nm", "coulomb_b_Nm", "contact_a_kg_m2", "contact_b_kg_m2")
"""Dry friction in parameters.toml: a torque of A and B at any speed, and one per square of the speed."""
DRAG = ("drag.a_Nms2_per_rad2", "drag.b_Nms2_per_rad2")
"""Air drag on A and B: torque over the square of the speed relative to the rotor; 0 if none was identified."""

BOW = ("bow_x_m", "bow_y_m")
"""Components of a bow by their field names in RotorParameters; 0 if none was identified."""


class Instrument(RigTable):
    """Instrument with which several numbers were measured: a balance, a caliper.

    relative_std is the relative standard uncertainty of its scale: one error common to all its measurements. type,
    distribution and degrees of freedom are those of that scale and of each number's own uncertainty.
    """

    measures: Annotated[list[str], Field(min_length=1)]
    relative_std: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    type: Kind = "B"
    distribution: Distribution = "normal"
    degrees_of_freedom: Positive | None = None


@dataclass(frozen=True)
class KnownSource:
    """One independent cause of error of known numbers.

    Attributes:
        name: key of the number in the rig file, or name of the instrument.
        std: standard uncertainty, in the number's unit, or relative for an instrument.
        unit: unit of `std`; "1" for an instrument.
        effects: number → its change per standard deviation of this source, in the number's unit.
        kind, distribution, degrees_of_freedom: as in GUM 4.2 and 4.3.
    """

    name: str
    std: float
    unit: str
    effects: Mapping[str, float]
    kind: Kind = "B"
    distribution: Distribution = "normal"
    degrees_of_freedom: float = math.inf

    @property
    def label(self) -> ErrorLabel:
        """Label of its errors in estimates."""
        return ErrorLabel("known", self.name)


@dataclass(frozen=True)
class KnownNumbers:
    """All known numbers of a rig.

    Attributes:
        values: every number.
        sources: causes of error with a standard uncertainty above 0.
        assumed: numbers whose standard uncertainty the rig file does not state: USUAL_SHARE of each is assumed.
    """

    values: Mapping[str, float]
    sources: tuple[KnownSource, ...] = field(default=())
    assumed: tuple[str, ...] = ()

    @property
    def exact(self) -> tuple[str, ...]:
        """Physical numbers that are not 0 and that the rig file states as exact."""
        moved = {name for source in self.sources for name in source.effects}
        return tuple(name for name in PHYSICAL if name not in moved and self.values.get(name, 0.0) != 0.0)

    def std(self, name: str) -> float:
        """Return the standard uncertainty of a number from all of its sources."""
        return math.hypot(*(source.effects.get(name, 0.0) for source in self.sources))


def assumed_remarks(names: Sequence[str]) -> list[str]:
    """Return the sentence that names numbers with an assumed standard uncertainty; empty if there are none.

    Args:
        names: as in `KnownNumbers.assumed`.
    """
    if not names:
        return []
    return [
        f"the rig file states no standard uncertainty of {', '.join(names)}: {100 * USUAL_SHARE:g} % of each is "
        "assumed; give mass_std_kg, length_std_m (0 if the number is exact)"
    ]


def physical_numbers(physics: RotorParameters) -> dict[str, float]:
    """Return the physical numbers that no test identifies, by name."""
    return {name: PHYSICAL_NUMBERS[name].of(physics) for name in PHYSICAL}


def with_number(physics: RotorParameters, name: str, value: float) -> RotorParameters:
    """Return the rig with one physical number changed and the seven identified parameters unchanged.

    Args:
        physics: parameters of the rig.
        name: name in PHYSICAL.
        value: new value in its unit.
    Raises:
        OutsideDomain: the value is impossible.
    """
    changed = PHYSICAL_NUMBERS[name].changed(physics, value)
    if name == "imbalance.mass_kg" and value > 0:
        return changed.with_values(SP_kg_m=physics.imbalance_moment_kg_m)
    return changed


def own_source(name: str, std: float, instrument: Instrument | None, places: tuple[str, ...] = ()) -> KnownSource:
    """Return the source of a number's own uncertainty.

    Args:
        name: name of the number.
        std: standard uncertainty in its unit.
        instrument: instrument of the measurement, or None.
        places: numbers that it changes equally; by default its own name.
    """
    effects = dict.fromkeys(places or (name,), std)
    unit = PHYSICAL_NUMBERS[next(iter(effects))].unit
    if instrument is None:
        return KnownSource(name, std, unit, effects)
    freedom = math.inf if instrument.degrees_of_freedom is None else instrument.degrees_of_freedom
    return KnownSource(name, std, unit, effects, instrument.type, instrument.distribution, freedom)


def scale_source(name: str, instrument: Instrument, values: Mapping[str, float]) -> KnownSource | None:
    """Return the source of an instrument's scale error; None if it has no error or measures nothing."""
    effects = {n: instrument.relative_std * values[n] for n in instrument.measures if values.get(n)}
    if not instrument.relative_std or not effects:
        return None
    freedom = math.inf if instrument.degrees_of_freedom is None else instrument.degrees_of_freedom
    return KnownSource(name, instrument.relative_std, "1", effects, instrument.type, instrument.distribution, freedom)
