"""Units at the border: unit words on the command line, and the units at the ends of field names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from daq.exchange.errors import ExchangeError
from rig_basics.texts import did_you_mean
from rig_basics.units import RPM

Quantity = Literal["time", "length", "angle", "speed"]

UNITS: Mapping[Quantity, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "in": 0.0254},
    "angle": {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi},
    "speed": {"rad/s": 1.0, "rpm": RPM, "Hz": 2 * math.pi, "deg/s": math.pi / 180},
}
"""Unit words with their values in s, m, rad, rad/s."""

_SUFFIXES = frozenset(("ns", "us", "ms", "s", "m", "mm", "um", "rad", "deg", "rpm", "Hz"))
_QUOTIENTS = {"_m_per_s": "m/s", "_rad_per_s": "rad/s", "_Nms_per_rad": "N m s/rad"}
_COUNTS = {"sequence", "counter", "count_a", "count_b", "revolutions", "device_ticks"}


def unit_of(field: str) -> str:
    """Return the unit in a field's name: ``displacement_m`` is in m; "count" for counters, "1" without a unit."""
    for ending, unit in _QUOTIENTS.items():
        if field.endswith(ending):
            return unit
    ending = field.rpartition("_")[2] if "_" in field else ""
    return "count" if field in _COUNTS else ending if ending in _SUFFIXES else "1"


@dataclass(frozen=True)
class ColumnChoice:
    """A column named on the command line.

    Attributes:
        name: name of the column, its number counted from 1, or the path of a variable.
        unit: unit as given: a unit word, with a minus sign for an axis in the opposite direction, or a number; "" if
            the file contains the unit.
        factor: value of the unit in s, m, rad or rad/s; negative for an axis in the opposite direction; NaN if the file
            contains the unit.
        time: column of this column's own times, if it does not share those of the recording.
    """

    name: str
    unit: str
    factor: float
    time: ColumnChoice | None = None


def parse_column(text: str, quantity: Quantity, field: str) -> ColumnChoice:
    """Parse a column and its unit: ``NAME:UNIT``, ``NAME:-UNIT``, ``NAME:NUMBER``, each optionally ``@TIME:UNIT``.

    The unit may be omitted if the name ends in it (``displacement_m``) or the file contains it above the column.

    Args:
        text: text of the entry.
        quantity: quantity of the column.
        field: field of the recipe, for messages.

    Raises:
        ExchangeError: a unit of another quantity, or a factor of 0.
    """
    own, at, time = text.rpartition("@")
    if not at:
        return _parse(text, quantity, field)
    choice = _parse(own, quantity, field)
    return ColumnChoice(choice.name, choice.unit, choice.factor, _parse(time, "time", f"{field} …@TIME"))


def _parse(text: str, quantity: Quantity, field: str) -> ColumnChoice:
    words = UNITS[quantity]
    name, colon, unit = text.rpartition(":")
    if not colon:
        name, unit = text, unit_of(text)
        if unit not in words:
            return ColumnChoice(name, "", math.nan)
    if not name:
        raise ExchangeError(f"{field} {text}: expected NAME:UNIT, got no name before the colon")
    factor = words.get(unit.removeprefix("-"), math.nan) * (-1 if unit.startswith("-") else 1)
    if math.isnan(factor):
        factor = _number(unit)
    if not math.isfinite(factor) or factor == 0:
        raise ExchangeError(
            f"{field} {text}: expected a unit of {quantity} ({', '.join(words)}) or a number other than 0 "
            f"after the colon, got {unit!r}{_hint(unit, quantity)}"
        )
    if quantity == "time" and factor < 0:
        raise ExchangeError(f"{field} {text}: expected a unit of time, got a negative one: time runs forward")
    return ColumnChoice(name, unit, factor)


def settle_unit(choice: ColumnChoice, file_unit: str | None, quantity: Quantity, field: str) -> ColumnChoice:
    """Return a choice with its unit, after comparing it with the unit in the file.

    Args:
        choice: the column.
        file_unit: unit in the file, a word of UNITS; None if the file contains none.
        quantity: quantity of the column.
        field: field of the recipe, for messages.

    Raises:
        ExchangeError: the unit is given neither by the recipe nor by the file, or both are different.
    """
    words = UNITS[quantity]
    if file_unit is not None and file_unit not in words:
        raise ExchangeError(
            f"{field} {choice.name}: expected a column of {quantity} ({', '.join(words)}), the file gives its unit "
            f"as {file_unit!r}; is it another column? If the file is wrong give the factor to SI as a number: "
            f"{field} {choice.name}:0.001"
        )
    if not choice.unit:
        if file_unit is None:
            raise ExchangeError(
                f"{field} {choice.name}: expected NAME:UNIT with a unit of {quantity} ({', '.join(words)}), got no "
                "unit, and the file does not contain it above the column"
            )
        return replace(choice, unit=file_unit, factor=words[file_unit])
    given = choice.unit.removeprefix("-")
    if file_unit is not None and given in words and words[given] != words[file_unit]:
        raise ExchangeError(
            f"{field} {choice.name}:{choice.unit}: expected the unit that the file gives the column, {file_unit!r}, "
            f"got {given!r}; if the file is wrong give the factor to SI as a number: {field} {choice.name}:"
            f"{choice.factor:g}"
        )
    return choice


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # usual: the name of a unit
        return math.nan


def _hint(unit: str, quantity: Quantity) -> str:
    for other, words in UNITS.items():
        if other != quantity and unit.removeprefix("-") in words:
            return f", which is a unit of {other}"
    return did_you_mean(unit, UNITS[quantity])
