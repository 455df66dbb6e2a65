# pyright: strict
"""Whether a sensor's reading has stopped following what it looks at, while another one sees the column move.

A sensor can hang and go on sending its last value, valid as ever. Standing still by itself proves nothing: a balanced
rotor and a simulation without noise do the same. But a turning rotor does not move along one direction alone, so a
reading that keeps to one value, bit by bit, while the other direction swings is no measurement. No clock, no I/O.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

STILL_S = 0.5
"""How long a reading stands still …"""
SWING_M = 50e-6
"""… while another one moves by so much: over a hundred steps of a sensor."""


@dataclass
class _Reading:
    """Of one channel: the value it holds, since when; how far the others have moved meanwhile, lowest and highest."""

    value: float = np.nan
    still: bool = False  # for a whole read at least
    since_ns: int = 0
    low_m: float = np.inf
    high_m: float = -np.inf


class StuckWatch:
    """Watches displacement channels against one another.

    Args:
        topics: of the channels.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._readings = {topic: _Reading() for topic in topics}

    def clear(self) -> None:
        """Forget what was seen."""
        for reading in self._readings.values():
            reading.value, reading.still = np.nan, False

    def feed(self, topic: str, time_ns: NDArray[np.int64], displacement_m: NDArray[np.floating[Any]]) -> str | None:
        """Take a channel's next samples; of a rotor that stands the answer means nothing.

        Args:
            topic: of the channel.
            time_ns, displacement_m: shape (n,), n ≥ 1; NaN where nothing was seen.

        Returns:
            What is wrong, once this channel has stood still for long enough beside another that moved.
        """
        own, newest = self._readings[topic], float(displacement_m[-1])
        if newest == own.value and displacement_m[0] == newest and bool(np.all(displacement_m == newest)):
            own.still = True
            swing_m = own.high_m - own.low_m
            still_s = (int(time_ns[-1]) - own.since_ns) * 1e-9
            if still_s >= STILL_S and swing_m >= SWING_M:
                return (
                    f"{topic}: reads {newest * 1e3:.4f} mm without any change for {still_s:.1f} s, while the column "
                    f"moves by {swing_m * 1e3:.2f} mm across it: the sensor hangs. Switch it off and on"
                )
        else:
            own.value, own.still = newest, False
            own.since_ns, own.low_m, own.high_m = int(time_ns[-1]), np.inf, -np.inf
        if any(other.still for other in self._readings.values()) and not np.isnan(newest):
            self._note(topic, displacement_m)
        return None

    def _note(self, topic: str, displacement_m: NDArray[np.floating[Any]]) -> None:
        """Keep a channel's motion beside the others' stillness."""
        low, high = float(np.fmin.reduce(displacement_m)), float(np.fmax.reduce(displacement_m))
        for other, reading in self._readings.items():
            if other != topic:
                reading.low_m, reading.high_m = min(reading.low_m, low), max(reading.high_m, high)
