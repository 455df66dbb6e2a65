"""Units as other programs write them above their columns: ``ms;mm;°;1/min``, ``[s],[mm]``, ``t (s)``, ``x / mm``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from daq.exchange.units import UNITS

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
    rest = (_bare(cell).lower() for cell, is_known in zip(cells, known, strict=True) if not is_known)
    return any(known) and all(word in _OTHERS or word in _NONE for word in rest)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """Split a column's name from its unit: ``t [s]``, ``x (mm)``, ``n / rpm``; the unit is None if it is missing."""
    found = _IN_A_NAME.match(cell.strip()) if len(cell) <= _LONGEST_NAME else None
    if found is None:
        return cell, None
    unit = unit_word(next(group for group in (found["a"], found["b"], found["c"], found["d"]) if group is not None))
    return (cell, None) if unit is None else (found["name"], unit)
