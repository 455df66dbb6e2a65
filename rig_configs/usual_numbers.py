"""Unusual numbers of a rig file that the schema allows: probable unit errors, in words.

They cause a warning only, because an unusual rig is possible.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

from rig_configs.physical_numbers import PhysicalNumber
from rig_configs.ports import PRINTED, is_placeholder
from rig_configs.schema import Rig
from rig_configs.table import RigTable


def doubts(rig: Rig) -> list[str]:
    """List probable errors of a rig file, one text each: the number, the probable unit, the usual range.

    Args:
        rig: loaded rig; the truth of a simulated one is not checked.
    """
    return [*_numbers(rig), *_ports(rig)]


def _numbers(table: RigTable, before: str = "") -> Iterator[str]:
    for name, value in table:
        key = before + name
        for place, each in {key: value, **{f"{key}.{part}": each for part, each in _inside(value).items()}}.items():
            if isinstance(each, RigTable) and place != "virtual":
                yield from _numbers(each, f"{place}.")
        number = _number(type(table), name)
        if number and isinstance(value, int | float) and (doubt := number.doubt(key, value)):
            yield doubt


def _inside(value: object) -> dict[str, object]:
    return cast("dict[str, object]", value) if isinstance(value, dict) else {}


def _number(model: type[RigTable], name: str) -> PhysicalNumber | None:
    """Return the row of a field, also if a driver gives the field limits of its own; None without a row."""
    models = [base for base in model.__mro__ if issubclass(base, RigTable) and name in base.model_fields]
    metadata = [each for base in models for each in base.model_fields[name].metadata]
    return next((each for each in metadata if isinstance(each, PhysicalNumber)), None)


def _ports(rig: Rig) -> Iterator[str]:
    for name, device in rig.devices.items():
        if is_placeholder(device.port) and not (rig.virtual and device.port == PRINTED):
            yield f"devices.{name}.port is {device.port!r}: a placeholder? Give the port that it is plugged into"
