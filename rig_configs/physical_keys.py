# pyright: strict
"""Physical numbers of a rig file by their dotted keys, changed in the physics without reading the file again."""

from __future__ import annotations

import dataclasses
import difflib

from dynamics import RotorParameters
from rig_configs.errors import RigFileError
from rig_configs.schema import Imbalance, Pendulums, PendulumTable, Rotor, Suspension
from rig_configs.table import Table

_IN_THE_ARM = "rolling_resistance_m"  # only as a part of friction_arm_m does the physics have it


def _numbers(table: type[Table]) -> list[str]:
    """Keys of a table's numbers, without their uncertainties."""
    return [
        key
        for key, field in table.model_fields.items()
        if field.annotation is float and "_std_" not in key and key != _IN_THE_ARM
    ]


PHYSICAL_KEYS: tuple[str, ...] = (
    *(f"rotor.{key}" for key in _numbers(Rotor)),
    *(f"imbalance.{key}" for key in _numbers(Imbalance)),
    *(f"pendulums.{name}.{key}" for name in ("a", "b") for key in _numbers(PendulumTable)),
    *(f"pendulums.{key}" for key in _numbers(Pendulums)),
    *(f"suspension.{key}" for key in _numbers(Suspension)),
)
"""Every number of the physical part of a rig file."""


def need_physical_key(key: str) -> None:
    """Whether a key is one of PHYSICAL_KEYS.

    Raises:
        RigFileError: it is not; the nearest one is named.
    """
    if key not in PHYSICAL_KEYS:
        near = difflib.get_close_matches(key, PHYSICAL_KEYS, 1, 0.5)
        hint = f", did you mean {near[0]}" if near else ""
        raise RigFileError(f"{key}: expected a number of the rig file{hint}; known: {', '.join(PHYSICAL_KEYS)}")


def with_physical(physics: RotorParameters, key: str, value: float) -> RotorParameters:
    """The rig with one number changed, everything else as it was.

    Args:
        key: of PHYSICAL_KEYS.
        value: in the key's unit.
    """
    section, _, name = key.partition(".")
    if section in ("rotor", "imbalance"):
        return dataclasses.replace(physics, **{f"{section}_{name}": value})
    which, _, of_pendulum = name.partition(".")
    if of_pendulum:
        pendulum = dataclasses.replace(physics.a if which == "a" else physics.b, **{of_pendulum: value})
        return dataclasses.replace(physics, **{which: pendulum})
    return dataclasses.replace(physics, **{name: value})
