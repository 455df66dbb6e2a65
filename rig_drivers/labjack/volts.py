"""Volts from the counts of a stream, by the calibration constants in the device's flash.

A T7 has for each range a slope above and one below the count of 0 V (the centre), for its high-speed converter; a T4 a
slope and an offset for each input.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import DeviceError

RANGES_V = (10.0, 1.0, 0.1, 0.01)
"""Ranges of a T7 input, V, in the order of their constants."""
_T7_BYTES, _T7_SET_BYTES = 164, 16
_T4_BYTES, _T4_SET_BYTES = 76, 8
CONSTANTS_BYTES = {"T7": _T7_BYTES, "T4": _T4_BYTES}
"""Size of the constants in the flash by model, bytes."""
BLANK_FLASH = b"\xff" * _T7_BYTES
"""Content of a flash without constants."""
T4_INPUTS = ("AIN0", "AIN1", "AIN2", "AIN3")
"""Inputs of a T4 for ±10 V. Its other inputs are for 0 to 2.5 V and shared with digital lines: not supported."""
T4_MISSING_LINES = ("FIO0", "FIO1", "FIO2", "FIO3")
"""Digital lines of a T7 that a T4 does not have: AIN0 … AIN3 are in their place."""
_MOST_V_PER_COUNT = 0.01


@dataclass(frozen=True)
class VoltScale:
    """Conversion of one input's counts.

    Attributes:
        zero: counts of 0 V.
        above_V, below_V: volts of one count above and below it, both positive.
    """

    zero: float
    above_V: float
    below_V: float

    def volts(self, counts: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Return the volts of counts, shape (n,)."""
        off = counts.astype(np.float64) - self.zero
        return off * np.where(off < 0, self.below_V, self.above_V)

    def of_range(self, range_V: float) -> VoltScale:
        """Return the scale of another range, from that of ±10 V."""
        return VoltScale(self.zero, self.above_V * range_V / 10.0, self.below_V * range_V / 10.0)

    def facts(self, name: str) -> dict[str, float]:
        """Return the scale as entries of a device's identity."""
        return {f"{name}_zero": self.zero, f"{name}_above_V": self.above_V, f"{name}_below_V": self.below_V}

    @classmethod
    def of(cls, identity: Mapping[str, Any], name: str) -> VoltScale | None:
        """Return the scale of a device's identity; None if the identity has none.

        Raises:
            DeviceError: the scale is impossible.
        """
        keys = (f"{name}_zero", f"{name}_above_V", f"{name}_below_V")
        if not any(key in identity for key in keys):
            return None
        values = [identity.get(key) for key in keys]
        scale = cls(*(float(v) if isinstance(v, int | float) else math.nan for v in values))
        if not scale.is_possible:
            raise DeviceError(f"identities.json: expected the constants of {name}, got {values!r:.120}")
        return scale

    @property
    def is_possible(self) -> bool:
        """Whether an input can have this scale."""
        slopes = (self.above_V, self.below_V)
        return 0 <= self.zero < 2**16 and all(0 < each < _MOST_V_PER_COUNT for each in slopes)


def nominal(model: str, range_V: float) -> VoltScale:
    """Return the nominal scale of an input of a T7 or T4 (easily wrong by some millivolts).

    Args:
        range_V: range of the input, one of RANGES_V; a T4 has 10 V only.
    """
    if model == "T4":
        return VoltScale(10.532965 / 3.235316e-4, 3.235316e-4, 3.235316e-4)
    return VoltScale(33523.0, 3.15805780e-4, 3.15805800e-4).of_range(range_V)


def read_constants(model: str, name: str, range_V: float, data: bytes) -> VoltScale | None:
    """Return the scale of an input from the constants in the flash; None if they are impossible (an empty flash).

    Args:
        model: "T7" or "T4".
        name: input, AIN0, AIN1, …; a T7 has the same constants for all inputs of a range.
        range_V: range of the input.
        data: the constants, of CONSTANTS_BYTES bytes.
    """
    if model == "T7":
        above, below, zero, _ = struct.unpack_from(">4f", data, _T7_SET_BYTES * RANGES_V.index(range_V))
        scale = VoltScale(zero, above, -below)
    else:
        slope, offset = struct.unpack_from(">2f", data, _T4_SET_BYTES * T4_INPUTS.index(name))
        scale = VoltScale(-offset / slope if slope else math.nan, slope, slope)
    return scale if scale.is_possible else None


def encode_constants(model: str, scales: Mapping[float | str, VoltScale]) -> bytes:
    """Return the constants in the flash; see `read_constants`.

    Args:
        model: "T7" or "T4".
        scales: scale of each range of a T7, or of each input of a T4; those left out are nominal.
    """
    if model == "T4":
        rows = [scales.get(name, nominal("T4", 10.0)) for name in T4_INPUTS]
        return b"".join(struct.pack(">2f", row.above_V, -row.zero * row.above_V) for row in rows)
    rows = [scales.get(range_V, nominal("T7", range_V)) for range_V in RANGES_V]
    return b"".join(struct.pack(">4f", row.above_V, -row.below_V, row.zero, -row.zero * row.below_V) for row in rows)
