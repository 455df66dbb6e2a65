"""Lengths as an operator writes them: "2.000 mm ± 1 µm", or several of one uncertainty: "2, 4, 6 mm ± 1 um"."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from daq.errors import AcquisitionError

_UNITS_M = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_FORM = re.compile(
    rf"(?P<sizes>{_NUMBER}(?:\s*[,;]\s*{_NUMBER})*)\s*(?P<unit>[a-zµμ]+)"
    rf"\s*(?:(?:±|\+-|\+/-)\s*(?P<std>{_NUMBER})\s*(?P<std_unit>[a-zµμ]+))?",
    re.ASCII,
)


class BadLength(AcquisitionError, ValueError):
    """The text is not a length. The message contains the expected form."""


@dataclass(frozen=True)
class KnownPosition:
    """A position of the target.

    Attributes:
        position_m: position, m.
        std_m: its standard uncertainty (k = 1), m.
    """

    position_m: float
    std_m: float


def positions_of(text: str) -> list[KnownPosition]:
    """Return the positions of a text.

    Raises:
        BadLength: not of the form "2.000 mm ± 1 µm" or "2, 4, 6 mm ± 1 µm".
    """
    found = _FORM.fullmatch(text.strip())
    if found is None or found["unit"] not in _UNITS_M:
        raise BadLength(f"{text!r}: expected a size with its standard uncertainty such as '2.000 mm ± 1 µm'")
    if found["std"] is None:
        raise BadLength(f"{text!r}: expected the standard uncertainty after the size, such as '2.000 mm ± 1 µm'")
    unit, std_unit = _UNITS_M[found["unit"]], _UNITS_M.get(found["std_unit"])
    if std_unit is None or not float(found["std"]) > 0:
        raise BadLength(f"{text!r}: expected a standard uncertainty above 0 in m, mm, µm or nm")
    std_m = float(found["std"]) * std_unit
    sizes = [float(size) * unit for size in re.split(r"\s*[,;]\s*", found["sizes"])]
    if not all(math.isfinite(size) and abs(size) < 1 for size in sizes):
        raise BadLength(f"{text!r}: expected positions below 1 m")
    return [KnownPosition(size, std_m) for size in sizes]
