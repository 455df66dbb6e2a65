"""Detection of a displacement sensor whose reading is frozen while another sensor measures a motion.

A faulty sensor may repeat its last value as a valid one. A constant reading alone is not a fault: a balanced rotor and
a simulation without noise give one too. A turning rotor, however, does not move in one direction only. Therefore a
reading that is constant to the last bit while the other direction swings is a fault.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

STILL_S = 0.5
"""Time for which a reading must be constant, s."""
SWING_M = 50e-6
"""Peak-to-peak displacement of another sensor meanwhile, m: more than a hundred steps of a sensor."""


@dataclass
class _Reading:
    """State of one channel.

    Attributes:
        value: newest reading, m.
        is_constant: whether the reading has been constant for at least one whole read.
        since_ns: time since which it is constant.
        low_m, high_m: extremes of the other channels since then, m.
    """

    value: float = np.nan
    is_constant: bool = False
    since_ns: int = 0
    low_m: float = np.inf
    high_m: float = -np.inf


class StuckWatch:
    """Compares displacement channels with each other.

    Args:
        topics: topics of the channels.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._readings = {topic: _Reading() for topic in topics}

    def clear(self) -> None:
        """Reset the state of all channels."""
        for reading in self._readings.values():
            reading.value, reading.is_constant = np.nan, False

    def feed(self, topic: str, time_ns: NDArray[np.int64], displacement_m: NDArray[np.floating[Any]]) -> str | None:
        """Process the next samples of a channel. The result is meaningful only while the rotor turns.

        Args:
            topic: topic of the channel.
            time_ns, displacement_m: times, ns, and displacements, m, shape (n,), n ≥ 1; NaN for invalid samples.

        Returns:
            Description of the fault, or None.
        """
        own, newest = self._readings[topic], float(displacement_m[-1])
        if newest == own.value and displacement_m[0] == newest and bool(np.all(displacement_m == newest)):
            own.is_constant = True
            swing_m = own.high_m - own.low_m
            constant_s = (int(time_ns[-1]) - own.since_ns) * 1e-9
            if constant_s >= STILL_S and swing_m >= SWING_M:
                return (
                    f"{topic}: reads {newest * 1e3:.4f} mm without any change for {constant_s:.1f} s, while the column "
                    f"moves by {swing_m * 1e3:.2f} mm across it: the sensor hangs. Switch it off and on"
                )
        else:
            own.value, own.is_constant = newest, False
            own.since_ns, own.low_m, own.high_m = int(time_ns[-1]), np.inf, -np.inf
        if any(other.is_constant for other in self._readings.values()) and not np.isnan(newest):
            self._note(topic, displacement_m)
        return None

    def _note(self, topic: str, displacement_m: NDArray[np.floating[Any]]) -> None:
        """Add the motion of a channel to the states of the other channels."""
        low, high = float(np.fmin.reduce(displacement_m)), float(np.fmax.reduce(displacement_m))
        for other, reading in self._readings.items():
            if other != topic:
                reading.low_m, reading.high_m = min(reading.low_m, low), max(reading.high_m, high)
