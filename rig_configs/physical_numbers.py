"""The table of physical numbers: what is true of each number of a rig, except its value.

Schema, units, symbols, checks of unusual values, priors of parameters and the tables of the documentation are read
from it (docs/decisions/0029-one-table-of-physical-numbers.md). `PHYSICAL_NUMBERS` is the table.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema

from dynamics.equations.parameters import RotorParameters
from rig_configs.errors import RigFileError

OTHER_UNITS: Mapping[str, tuple[tuple[float, str], ...]] = {
    "kg": ((1e-3, "grams"), (1e3, "tonnes")),
    "m": ((1e-3, "millimetres"), (1e-2, "centimetres")),
    "N/m": ((1e3, "N/mm"),),
    "1": ((1e-2, "per cent"),),
    "N m s/rad": ((1e-3, "mN m s"), (1e-2, "N cm s")),
    "m/s²": ((9.81, "g"),),
    "rpm": ((60, "Hz"), (9.55, "rad/s")),
    "Hz": ((1e3, "kHz"),),
}
"""Unit of the rig file → units that are used by mistake: factor to the unit of the rig file, and name."""

_OF_EQUATIONS = ("rotor", "imbalance", "pendulums", "suspension")


@dataclass(frozen=True)
class PhysicalNumber:
    """What is true of one number of a rig, except its value. As metadata of a field of the schema it sets the limits.

    Attributes:
        key: dotted key in the rig file; of a number of devices, the key behind the device's name; of a number that the
            rig file does not contain, its name.
        unit: SI unit; "1" for a ratio.
        kind: what it is, in words.
        symbol: symbol in texts and figures; "" without one.
        part: part of the rig or direction that it belongs to, in words; "" if the rig has one number of this kind.
        above, least, most: limits in the rig file: the number is above, at least, at most this. None: no such limit.
        usual: usual range in its unit, generous on both sides; None if every value is usual.
        zero: meaning of 0; None if 0 is not special.
        known: whether it is measured outside of the rig, with a standard uncertainty, and no test identifies it.
        parameter: name in parameters.toml; "" if no test identifies it.
        design_share: relative standard uncertainty of a rig file's value that no test has identified.
        replaces: keys of the rig file whose values an identified one replaces, if they are not `key`; the last of them
            is changed.
    """

    key: str
    unit: str
    kind: str
    symbol: str = ""
    part: str = ""
    above: float | None = None
    least: float | None = None
    most: float | None = None
    usual: tuple[float, float] | None = None
    zero: str | None = None
    known: bool = False
    parameter: str = ""
    design_share: float = 0.0
    replaces: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a field that has this number as metadata: with its limits."""
        limits = {"gt": self.above, "ge": self.least, "le": self.most}
        schema: Any = handler(source)
        schema.update({name: limit for name, limit in limits.items() if limit is not None})
        return schema

    @property
    def is_physics(self) -> bool:
        """Whether it is a number of the equations of motion that the rig file contains."""
        return self.key.partition(".")[0] in _OF_EQUATIONS

    @property
    def places(self) -> tuple[str, ...]:
        """Keys of the rig file whose values an identified one replaces; the last of them is changed."""
        return self.replaces or (self.key,)

    @property
    def std_key(self) -> str:
        """Key in the rig file of its standard uncertainty: `mass_std_kg` of `mass_kg`."""
        return re.sub(r"_([a-zA-Z]+)$", r"_std_\1", self.key)

    @property
    def shown_unit(self) -> str:
        """Unit after a space, as it follows a value; empty for a ratio."""
        return "" if self.unit == "1" else f" {self.unit}"

    def doubt(self, key: str, value: float) -> str | None:
        """Describe why a value is unusual; None if it is usual.

        Args:
            key: key in the rig file.
            value: value in its unit.
        """
        if self.usual is None or (value == 0 and self.zero is not None):
            return None
        (least, most), unit = self.usual, self.shown_unit
        if least <= value <= most:
            return None
        meant = [name for factor, name in OTHER_UNITS.get(self.unit, ()) if least <= value * factor <= most]
        slip = f": {' or '.join(meant)}?" if meant else "."
        none = f", or 0 for {self.zero}" if self.zero else ""
        return f"{key} is {value:g}{unit}{slip} Usual is {least:g} to {most:g}{unit}{none}"

    def of(self, physics: RotorParameters) -> float:
        """Return its value in a rig."""
        return attrgetter(self._place)(physics)

    def changed(self, physics: RotorParameters, value: float) -> RotorParameters:
        """Return the rig with this number changed.

        Args:
            physics: parameters of the rig.
            value: new value in its unit.
        Raises:
            OutsideDomain: the value is impossible.
        """
        part, _, name = self._place.rpartition(".")
        if not part:
            return dataclasses.replace(physics, **{name: value})
        return dataclasses.replace(physics, **{part: dataclasses.replace(getattr(physics, part), **{name: value})})

    @property
    def _place(self) -> str:
        """Place in RotorParameters."""
        section, _, name = self.key.partition(".")
        return f"{section}_{name}" if section in ("rotor", "imbalance") else name


def short(name: str) -> str:
    """Return the name of a parameter without its unit: k1 of `k1_N_per_m`."""
    return name.partition("_")[0]


# fmt: off
def _of_pendulum(part: str, damping: str) -> tuple[PhysicalNumber, ...]:
    """Return the rows of pendulum a or b, whose damping is c3 or c4."""
    of, name = f"pendulums.{part}", part.upper()
    return (
        PhysicalNumber(f"{of}.mass_kg", "kg", "mass", f"M_{name}", f"of {name}", least=0, most=100, usual=(1e-3, 5),
                       zero="no pendulum", known=True),
        PhysicalNumber(f"{of}.length_m", "m", "distance from the pivot", f"R_{name}", f"of {name}", above=0,
                       most=1, usual=(3e-3, 0.3), known=True),
        # An eddy-current damper, as along x and y.
        PhysicalNumber(f"{of}.damping_Nms_per_rad", "N m s/rad", "pendulum damping", damping, f"of {name}", least=0,
                       most=50, usual=(1e-7, 0.1), zero="none", parameter=f"{damping}_Nms_per_rad", design_share=0.7),
        PhysicalNumber(f"{of}.drag_Nms2_per_rad2", "N m s²/rad²", "air drag", "", f"of {name}", least=0, most=1),
        PhysicalNumber(f"{of}.friction_arm_m", "m", "dry friction torque per contact force", "", f"of {name}", least=0,
                       most=0.1, usual=(1e-7, 0.02), zero="none"),
        PhysicalNumber(f"{of}.ball_radius_m", "m", "radius of the ball", "", f"of {name}", least=0, most=1,
                       usual=(5e-4, 0.1), zero="a pendulum"),
        PhysicalNumber(f"{of}.ball_inertia_ratio", "1", "I/(m r²) of the ball", "", f"of {name}", least=0, most=1),
        PhysicalNumber(f"{of}.rolling_resistance_m", "m", "rolling resistance of the ball", "", f"of {name}", least=0,
                       most=0.01, usual=(1e-8, 1e-3), zero="none"),
    )


# A row of the table is one or two lines: key, unit, kind, symbol, part; limits, usual range; what tests make of it.
_TABLE = (
    PhysicalNumber("rotor.mass_kg", "kg", "mass of disk and column", above=0, most=1e4, usual=(0.05, 2000), known=True),
    PhysicalNumber("imbalance.mass_kg", "kg", "mass of the imbalance weight", "M_P", least=0, most=100,
                   usual=(1e-5, 3), zero="no weight", known=True),
    PhysicalNumber("imbalance.radius_m", "m", "distance of the imbalance weight from the axis", "P_3", least=0, most=1,
                   usual=(1e-4, 0.5), zero="no weight"),
    # The stiffness of a bar grows with the fourth power of its thickness, of which 3 to 4 % are usual, with its
    # clamping.
    *(PhysicalNumber(f"suspension.k{i}_N_per_m", "N/m", "stiffness", f"k{i}", f"along {axis}", above=0, most=1e9,
                     usual=(20, 1e8), parameter=f"k{i}_N_per_m", design_share=0.15)
      for i, axis in ((1, "x"), (2, "y"))),
    # An eddy-current damper grows with the square of the field in its gap, which is known to a third.
    *(PhysicalNumber(f"suspension.zeta{i}", "1", "damping ratio", f"ζ{i}", f"along {axis}", least=0, most=2,
                     usual=(0, 0.5), parameter=f"zeta{i}", design_share=0.7)
      for i, axis in ((1, "x"), (2, "y"))),
    PhysicalNumber("suspension.gravity_m_per_s2", "m/s²", "gravity in the plane of the disk, along −y", least=0,
                   most=30, usual=(9.7, 9.9), zero="an upright shaft"),
    *(number for part, damping in (("a", "c3"), ("b", "c4")) for number in _of_pendulum(part, damping)),
    PhysicalNumber("pendulums.pivot_shift_m", "m", "shift of the pivots towards the imbalance", "R_C", least=0,
                   most=0.1, usual=(1e-6, 0.02), zero="none", known=True),
    # A brass weight sits within 1 mm on a radius of 20 mm.
    PhysicalNumber("SP_kg_m", "kg m", "first mass moment of the imbalance", "S_P", parameter="SP_kg_m",
                   design_share=0.05, replaces=("imbalance.mass_kg", "imbalance.radius_m")),
    PhysicalNumber("encoders.a.zero_rad", "rad", "zero of the encoder", "", "of A", known=True),
    PhysicalNumber("encoders.b.zero_rad", "rad", "zero of the encoder", "", "of B", known=True),
    PhysicalNumber("phase.index_angle_rad", "rad", "angle of the index mark", known=True),
    PhysicalNumber("limits.speed_rpm", "rpm", "speed above which the rotor is stopped", above=0, most=3000,
                   usual=(30, 3000)),
    PhysicalNumber("limits.amplitude_m", "m", "amplitude above which the rotor is stopped", above=0,
                   usual=(1e-4, 0.05)),
    PhysicalNumber("sensor.rate_Hz", "Hz", "samples of a sensor per second", above=0, usual=(20, 2e5)),
    PhysicalNumber("node.rate_Hz", "Hz", "samples of an encoder node per second", least=10, most=5000, usual=(20, 2e5)),
    PhysicalNumber("range_m", "m", "measuring range of a sensor", above=0, usual=(2e-4, 1)),
    PhysicalNumber("lever_ratio", "1", "displacement at a sensor over that of the disk centre", above=0,
                   usual=(0.1, 10)),
    PhysicalNumber("gain_std", "1", "relative standard uncertainty of a sensor's calibration", least=0, most=0.1,
                   usual=(1e-6, 0.05), zero="none"),
    PhysicalNumber("clock_tolerance_ppm", "ppm", "standard uncertainty of the rate of a device's clock", above=0,
                   usual=(0.01, 1000)),
)
# fmt: on

PHYSICAL_NUMBERS: Mapping[str, PhysicalNumber] = {number.key: number for number in _TABLE}
"""All physical numbers, by key."""
PARAMETERS: Mapping[str, PhysicalNumber] = {each.parameter: each for each in _TABLE if each.parameter}
"""Numbers that tests identify, by name in parameters.toml."""
PHYSICAL_KEYS = tuple(
    key for key, each in PHYSICAL_NUMBERS.items() if each.is_physics and not key.endswith("rolling_resistance_m")
)
"""All numbers of the equations of motion in a rig file. Rolling resistance is a part of the friction arm."""


def need_physical_key(key: str) -> None:
    """Check that a key is in PHYSICAL_KEYS.

    Raises:
        RigFileError: it is not; the message contains the nearest key.
    """
    if key not in PHYSICAL_KEYS:
        near = difflib.get_close_matches(key, PHYSICAL_KEYS, 1, 0.5)
        hint = f", did you mean {near[0]}" if near else ""
        raise RigFileError(f"{key}: expected a number of the rig file{hint}; known: {', '.join(PHYSICAL_KEYS)}")
