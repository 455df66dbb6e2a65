"""Distance words of an optoNCDT 2300 on Ethernet.

The sensor itself sends the distance as a signed number of nanometres; the largest numbers are error codes. A converter
between its serial line and Ethernet passes the words of the serial line on, which the other scalings are for.
Source: docs/protocols/optoncdt_ethernet.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from daq.drivers.optoncdt import distance_words

NANOMETRES = "nm"
"""Scaling of the sensor's own Ethernet output."""
MOST_NM = 2_147_000_000
"""Largest distance either way, nm; larger words are error codes."""
_STEP_M = 1e-9
_MOST_SERIAL = 262_143  # largest word of 18 bits: 0.26 mm in nanometres
_LEAST_NM = 300_000  # a word above those of the serial line
_LEAST_RANGE_M = 2e-3  # of a sensor whose words are compared: a larger part of a smaller range is ambiguous
_WATCHED_WORDS = 1000
_NM_CODES = {"no peak": 0x7FFF_FFFB, "before": 0x7FFF_FFFA, "behind": 0x7FFF_FFF9}
_SERIAL_CODES = {
    "no peak": distance_words.NO_PEAK,
    "before": distance_words.BEFORE_RANGE,
    "behind": distance_words.BEHIND_RANGE,
}


def codes_of(scaling: str) -> dict[str, int]:
    """Return the words for no peak, and for a peak before and behind the measuring range."""
    return _NM_CODES if scaling == NANOMETRES else _SERIAL_CODES


def metres(words: NDArray[np.uint32], range_m: float, scaling: str) -> NDArray[np.float64]:
    """Return the distances from the start of the measuring range, m; NaN for error codes."""
    if scaling != NANOMETRES:
        return distance_words.metres(words, range_m, distance_words.SCALINGS[scaling])
    signed = words.view(np.int32).astype(np.float64)
    return np.where(np.abs(signed) <= MOST_NM, signed * _STEP_M, np.nan)


def code(metres: ArrayLike, range_m: float, scaling: str) -> NDArray[np.uint32]:
    """Return the words of distances; inverse of `metres`."""
    if scaling != NANOMETRES:
        return distance_words.code(metres, range_m, distance_words.SCALINGS[scaling])
    return np.rint(np.asarray(metres, np.float64) / _STEP_M).astype(np.int32).view(np.uint32)


class ScalingWatch:
    """Compares the first words with the other scaling, since the two differ by a factor of some hundred.

    Args:
        scaling, range_m: settings of the sensor.
    """

    def __init__(self, scaling: str, range_m: float) -> None:
        self._scaling, self._range_m = scaling, range_m
        self._left = _WATCHED_WORDS if range_m >= _LEAST_RANGE_M else 0

    def contradiction(self, words: NDArray[np.uint32]) -> str:
        """Take the next words; return what contradicts the scaling once all watched ones do, "" otherwise."""
        if not self._left:
            return ""
        known = words[words <= MOST_NM]
        largest = _MOST_SERIAL if self._scaling == NANOMETRES else round(self._range_m / _STEP_M)
        least = 0 if self._scaling == NANOMETRES else _LEAST_NM
        if not np.all((known >= least) & (known <= largest)):
            self._left = 0
            return ""
        self._left = max(0, self._left - len(known))
        if self._left:
            return ""
        if self._scaling == NANOMETRES:
            return 'its distances are words of a serial line, not nanometres: set scaling = "ILD1420", or "ILD1900"'
        return 'its distances are nanometres, not words of a serial line: set scaling = "nm"'
