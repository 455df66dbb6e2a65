"""Physical numbers of a rig file by their dotted keys, for changes without reading the file again."""

from __future__ import annotations

import dataclasses
import difflib

from dynamics import RotorParameters
from rig_configs.errors import RigFileError
from rig_configs.schema import Imbalance, Pendulums, PendulumTable, Rotor, Suspension
from rig_configs.table import RigTable

_IN_THE_ARM = "rolling_resistance_m"  # enters the physics only as a part of friction_arm_m


def _numbers(table: type[RigTable]) -> list[str]:
    """Return the keys of a table's numbers, without their uncertainties."""
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
"""All numbers of the physical part of a rig file."""


def need_physical_key(key: str) -> None:
    """Check that a key is in PHYSICAL_KEYS.

    Raises:
        RigFileError: it is not; the message contains the nearest key.
    """
    if key not in PHYSICAL_KEYS:
        near = difflib.get_close_matches(key, PHYSICAL_KEYS, 1, 0.5)
        hint = f", did you mean {near[0]}" if near else ""
        raise RigFileError(f"{key}: expected a number of the rig file{hint}; known: {', '.join(PHYSICAL_KEYS)}")


def with_physical(physics: RotorParameters, key: str, value: float) -> RotorParameters:
    """Return the rig with one number changed.

    Args:
        physics: parameters of the rig.
        key: key in PHYSICAL_KEYS.
        value: new value in the key's unit.
    """
    section, _, name = key.partition(".")
    if section in ("rotor", "imbalance"):
        return dataclasses.replace(physics, **{f"{section}_{name}": value})
    which, _, of_pendulum = name.partition(".")
    if of_pendulum:
        pendulum = dataclasses.replace(physics.a if which == "a" else physics.b, **{of_pendulum: value})
        return dataclasses.replace(physics, **{which: pendulum})
    return dataclasses.replace(physics, **{name: value})
