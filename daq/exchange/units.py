"""Units at the border: unit words on the command line, and the units at the ends of field names.

Other programs write units above their columns: ``ms;mm;°;1/min``, ``[s],[mm]``, ``t (s)``, ``x / mm``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
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


_KNOWN = {word for words in UNITS.values() for word in words}
_SAME = {
    "s": "sec secs second seconds sekunde sekunden",
    "ms": "msec millisecond milliseconds millisekunden",
    "us": "usec microsecond microseconds",
    "min": "minute minutes minuten",
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometre",
    "in": "inch inches",
    "deg": "° degree degrees",
    "rad": "radian radians",
    "rev": "turn turns revolution revolutions u",
    "rpm": "1/min /min min-1 min^-1 min**-1 min⁻¹ r/min rev/min u/min upm",
    "Hz": "hz hertz rev/s r/s u/s",
    "deg/s": "°/s deg/sec degree/s degrees/s",
    "rad/s": "rad/sec rad*s-1 rad·s-1 rad/s-1",
}
_BY_WORD = {same: unit for unit, words in _SAME.items() for same in words.split()}
# units of quantities that are not imported, and marks for "no unit"; they identify a row of units
_OTHER_WORDS = (
    "v mv µv a ma n kn nm n·m n*m g kg m/s mm/s m/s² m/s^2 m/s2 mm/s² mm/s^2 1/s s-1 s^-1 s⁻¹ °c degc k c f °f pa kpa "
    "mpa bar mbar db % ‰ khz cm km h d w kw bit bits count counts digit digits inc #"
)
_OTHERS = frozenset(_OTHER_WORDS.split())
_NONE = frozenset(("", "-", "--", "1", "[]", "()", "n/a", "none", "."))
_BRACKETS = re.compile(r"^(?:\[(.*)\]|\((.*)\)|\{(.*)\}|<(.*)>|\"(.*)\"|'(.*)')$")
_LONGEST_NAME = 1000  # the time to find a unit in a name grows with the square of its length
_IN_A_NAME = re.compile(
    r"^(?P<name>.*\S)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()]*)\)|\s/\s*(?P<c>\S+)|\s+in\s+(?P<d>\S+))$"
)


def _bare(cell: str) -> str:
    """Return a cell without brackets, with one spelling of micro and degree."""
    if len(cell) > _LONGEST_NAME:
        return cell
    text = cell.strip().removesuffix(":").strip()
    while found := _BRACKETS.match(text):
        text = next(group for group in found.groups() if group is not None).strip()
    text = text.removeprefix("in ").strip() if text.startswith("in ") else text
    return text.replace("Â", "").replace("μ", "µ").replace("º", "°").replace("˚", "°")


def unit_word(cell: str) -> str | None:
    """Return the unit of daq.exchange.units in a cell; None if it contains none of them."""
    text = _bare(cell)
    for word in (text, text.lower()):
        if word in _KNOWN:
            return word.replace("µ", "u")
        if word.replace("µ", "u") in _BY_WORD:
            return _BY_WORD[word.replace("µ", "u")]
    return None


def is_unit_row(cells: Sequence[str]) -> bool:
    """Return True if cells are units of the columns: each a unit or empty, at least one a known unit."""
    known = [unit_word(cell) is not None for cell in cells]
    others = (_bare(cell).lower() for cell, is_known in zip(cells, known, strict=True) if not is_known)
    return any(known) and all(word in _OTHERS or word in _NONE for word in others)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """Split a column's name from its unit: ``t [s]``, ``x (mm)``, ``n / rpm``; the unit is None if it is missing."""
    found = _IN_A_NAME.match(cell.strip()) if len(cell) <= _LONGEST_NAME else None
    if found is None:
        return cell, None
    unit = unit_word(next(group for group in (found["a"], found["b"], found["c"], found["d"]) if group is not None))
    return (cell, None) if unit is None else (found["name"], unit)
