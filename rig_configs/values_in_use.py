"""Values that a calculation uses: each with its standard uncertainty and its origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rig_configs.known import PHYSICAL
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.physical_numbers import PARAMETERS, PHYSICAL_NUMBERS
from rig_configs.schema import Rig

Origin = Literal["identified", "design", "stated", "assumed", "exact"]
"""Origin of a value and of its uncertainty.

identified: by tests; design: the rig file's value of a parameter that no test has identified; stated, assumed, exact:
a number of the rig file whose uncertainty the file states, does not state, or states as 0.
"""


@dataclass(frozen=True)
class ValueInUse:
    """One value.

    Attributes:
        name: name in parameters.toml, or key in the rig file.
        value, std: value and standard uncertainty, in `unit`.
        unit: SI unit.
        origin: see Origin.
    """

    name: str
    value: float
    std: float
    unit: str
    origin: Origin


def values_in_use(rig: Rig, identified: IdentifiedParameters) -> list[ValueInUse]:
    """Return all values that a calculation with these parameters uses, the parameters first.

    Args:
        rig: rig file.
        identified: parameters that replace values of the rig file.
    """
    known, found = rig.known, list[ValueInUse]()
    whole = identified.completed(rig.physics)
    for name, value in whole.values.items():
        origin: Origin = "identified" if name in identified.values else "design"
        found.append(ValueInUse(name, value, whole.std[name], PARAMETERS[name].unit, origin))
    for name in PHYSICAL:
        kind: Origin = "assumed" if name in known.assumed else "stated" if known.std(name) > 0 else "exact"
        found.append(ValueInUse(name, known.values[name], known.std(name), PHYSICAL_NUMBERS[name].unit, kind))
    return found
