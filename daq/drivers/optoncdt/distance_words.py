"""Scaling of the distance words of optoNCDT sensors, and their error codes.

Sources: ILD1420 manual, scaling pages; manuals of the IF2030 and IF2035 field-bus converters.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

CODE_MAX = 65520
"""Largest distance code of an ILD1420; anything above is an error code."""

TOO_MUCH_DATA, NO_PEAK, BEFORE_RANGE, BEHIND_RANGE = range(262075, 262079)
"""Error codes of a line that is too slow, and of a target that is not seen, before or behind the measuring range."""
OUT_OF_RANGE = (BEFORE_RANGE, BEHIND_RANGE)
"""Codes of a target before or behind the measuring range."""

ERROR_CODES = {
    262073: "scaling underflow",
    262074: "scaling overflow",
    TOO_MUCH_DATA: "too much data for the baud rate",
    NO_PEAK: "no peak",
    BEFORE_RANGE: "peak before the measuring range",
    BEHIND_RANGE: "peak behind the measuring range",
    262079: "cannot be calculated",
    262080: "cannot be calculated",
    262081: "peak too large",
    262082: "laser is off",
}
"""Distance words that are error codes, and their meaning (18 bits; never mask them to 16 bits before the test)."""

REMEDIES = {
    TOO_MUCH_DATA: "set a lower rate or a higher baud rate",
    BEFORE_RANGE: "move the target away from the sensor",
    BEHIND_RANGE: "move the target towards the sensor",
    262081: "reduce the reflected light",
    262082: "switch the laser on: LASERPOW FULL, its web page, or its input",
}
"""What to do about error codes whose cause is known."""


class Scaling(NamedTuple):
    """Scaling of a distance word x: d = (span / steps · x − zero) · range / whole, without mastering.

    Attributes:
        models: numbers of the models with this scaling.
        most: largest word that is a distance; larger words are error codes.
        span, steps, zero, whole: constants of the formula, dimensionless.
    """

    models: tuple[str, ...]
    most: int
    span: float
    steps: float
    zero: float
    whole: float


MASTERED = "ILD1420 mastered"
"""Scaling of a sensor of the ILD1420's family that keeps the zero which was set in it (mastering).

Its words have 18 bits and give (102/65520 · x − 51) · range/100 from that zero. The middle of the range is 50 % less
without mastering, so the displacement from the middle, or from the zero, is the same function of the word.
"""

SCALINGS = {
    "ILD1420": Scaling(("1220", "1320", "1420", "2300"), CODE_MAX, 102.0, float(CODE_MAX), 1.0, 100.0),
    MASTERED: Scaling((), min(ERROR_CODES) - 1, 102.0, float(CODE_MAX), 1.0, 100.0),
    "ILD1900": Scaling(("1750", "1900"), 230_604, 1.0, 1.0, 98_232.0, 65_536.0),
}
"""Scalings, by a model that has it. Sources: ILD1420 manual, scaling of the 16-bit distance, −1 … 101 % of the range;
for the ILD1750 and ILD1900, of 18 bits, the manuals of the IF2030 and IF2035 field-bus converters."""
USUAL_SCALING = "ILD1420"
"""Scaling of a sensor that was not queried."""


SHORT_TIMESTAMP = frozenset({"2300"})
"""Models whose manual states one value of 18 bits in steps of 256 µs as their timestamp on the serial line. Source:
manual of the ILD2300, RS422."""


def model_of(name: str) -> str:
    """Return the number of the model in a sensor's name, like ``ILD1420-25``; empty without one."""
    found = re.search(r"(?<!\d)\d{4}(?!\d)", name)
    return found[0] if found else ""


def scaling_of(name: str) -> str | None:
    """Return the key in `SCALINGS` for a sensor's name, like ``ILD1420-25``; None if its model is unknown."""
    return next((key for key, scaling in SCALINGS.items() if model_of(name) in scaling.models), None)


def metres(code: ArrayLike, range_m: float, scaling: Scaling = SCALINGS[USUAL_SCALING]) -> NDArray[np.float64]:
    """Convert distance words to distances from the start of the measuring range.

    Args:
        code: distance words, any shape.
        range_m: measuring range, m.
        scaling: scaling of the sensor's model.

    Returns:
        Distance, m, same shape; NaN for error codes.
    """
    words = np.asarray(code, np.float64)
    distance = (scaling.span / scaling.steps * words - scaling.zero) * range_m / scaling.whole
    return np.where(words <= scaling.most, distance, np.nan)


def code(metres: ArrayLike, range_m: float, scaling: Scaling = SCALINGS[USUAL_SCALING]) -> NDArray[np.uint32]:
    """Convert distances to the words that a sensor sends; inverse of `metres` to half a step (range · 7.8e-6).

    Args:
        metres: distance from the start of the measuring range, m, any shape; NaN without a target.
        range_m: measuring range, m.
        scaling: scaling of the sensor's model.

    Returns:
        uint32, same shape; error code 262077 below the first word that is a distance (ILD1420: −1 % of the range),
        262078 above the last (101 %), 262076 for NaN.
    """
    distance = np.asarray(metres, np.float64)
    exact = np.rint((distance * scaling.whole / range_m + scaling.zero) * (scaling.steps / scaling.span))
    words = np.where(exact < 0, BEFORE_RANGE, np.where(exact > scaling.most, BEHIND_RANGE, exact))
    return np.where(np.isnan(exact), NO_PEAK, words).astype(np.uint32)
