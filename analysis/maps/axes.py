"""Axes of a map: one number of a rig, or several with equal values, and its values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.stability.map_plane import INVERSE, ROOT, SAME, Coordinate
from rig_configs import RigFileError
from rig_configs.physical_numbers import PHYSICAL_NUMBERS, need_physical_key

SPEED_RATIO, SPEED_RPM, STIFFNESS_RATIO = "speed_ratio", "speed_rpm", "stiffness_ratio"
NAMES = {
    SPEED_RATIO: "speed ratio Ω = ω/ω_n1",
    SPEED_RPM: "speed, rpm",
    STIFFNESS_RATIO: "stiffness ratio K = k2/k1",
}
"""Numbers that are not in a rig file, with their names in figures."""
SPEEDS = (SPEED_RATIO, SPEED_RPM)
_ROOTS = (STIFFNESS_RATIO, "suspension.k1_N_per_m", "suspension.k2_N_per_m")
_MAX_COUNT = 10_000_000


@dataclass(frozen=True)
class MapAxis:
    """One number, or several with equal values, from a first value to a last.

    Attributes:
        keys: dotted keys of the rig file, or speed_ratio, speed_rpm, stiffness_ratio.
        low, high: first and last value.
        count: number of values.
        logarithmic: whether the values are spaced evenly in the logarithm.
    Raises:
        RigFileError: an unknown number, numbers that cannot have equal values, or an impossible range.
    """

    keys: tuple[str, ...]
    low: float
    high: float
    count: int
    logarithmic: bool = False

    def __post_init__(self) -> None:
        need_alike(self.keys)
        least = 0.0 if self.is_positive or self.logarithmic else -math.inf
        fits = least < self.low <= self.high < math.inf and 1 <= self.count <= _MAX_COUNT
        if not fits or (self.count > 1 and self.low == self.high):
            above = "0 < A < B" if least == 0.0 else "A < B, both finite,"
            raise RigFileError(f"{self.key}: expected {above} and N from 1 to ten million, got {self.text!r}")

    @property
    def key(self) -> str:
        """The keys as on the command line."""
        return "+".join(self.keys)

    @property
    def text(self) -> str:
        """KEY=A:B:N or KEY=A:B:N:log."""
        return f"{self.key}={self.low!r}:{self.high!r}:{self.count}{':log' if self.logarithmic else ''}"

    @property
    def values(self) -> NDArray[np.float64]:
        """Values of the number, rising, shape (count,)."""
        if self.logarithmic:
            return np.geomspace(self.low, self.high, self.count)
        return np.linspace(self.low, self.high, self.count)

    @property
    def name(self) -> str:
        """Label of a figure's axis."""
        return name_of(self.keys)

    @property
    def is_speed(self) -> bool:
        """Whether the number is the rotor's speed."""
        return self.keys[0] in SPEEDS

    @property
    def is_positive(self) -> bool:
        """Whether the number is positive by definition."""
        return self.keys[0] in NAMES or self.keys[0] in _ROOTS

    @property
    def span(self) -> tuple[float, float]:
        """First and last value."""
        return self.low, self.high

    @property
    def coordinate(self) -> Coordinate:
        """Coordinate in which the half-turn matrix is smooth."""
        return INVERSE if self.is_speed else ROOT if self.keys[0] in _ROOTS else SAME

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers and texts for `of_json`."""
        return {
            "keys": list(self.keys),
            "from": self.low,
            "to": self.high,
            "count": self.count,
            "logarithmic": self.logarithmic,
        }

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> MapAxis:
        """Return the axis of an `as_json` table."""
        keys, count = tuple(map(str, table["keys"])), int(table["count"])
        return cls(keys, float(table["from"]), float(table["to"]), count, bool(table["logarithmic"]))


def need_alike(keys: tuple[str, ...]) -> None:
    """Check that all keys exist and can have equal values.

    Raises:
        RigFileError: names the first unknown key, with the nearest known one.
    """
    for key in keys:
        if key not in NAMES:
            need_physical_key(key)
    if len(keys) > 1 and any(key in NAMES for key in keys):
        raise RigFileError(f"{'+'.join(keys)} cannot change alike; only numbers of the rig file can")


def symbol_of(keys: tuple[str, ...]) -> tuple[str, str]:
    """Return the numbers' symbols, joined by =, and their unit after a space; the key replaces a missing symbol."""
    found = [PHYSICAL_NUMBERS[key] for key in keys if key in PHYSICAL_NUMBERS and PHYSICAL_NUMBERS[key].symbol]
    if len(found) < len(keys):
        return " = ".join(keys), ""
    return " = ".join(number.symbol for number in found), found[0].shown_unit


def name_of(keys: tuple[str, ...]) -> str:
    """Return the numbers' name for an axis of a figure."""
    number = PHYSICAL_NUMBERS.get(keys[0])
    if number is None or not number.symbol:
        return " = ".join(NAMES.get(key, key) for key in keys)
    symbol, unit = symbol_of(keys)
    return f"{number.kind} {symbol}{',' if unit else ''}{unit}"
