# pyright: strict
"""The far end of a device's line: what speaks its bytes when the rig is simulated.

A far end knows the device's wire and a motion; it knows no port and reads no clock. Time is the rig's, s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


class Stretch(Protocol):
    """Motion of the rig over a short time.

    Attributes:
        time_s: instants, shape (n,).
        rows: x, y, θ3, θ4, their rates, ψ and its rate at each, shape (n, 10); m, rad, s.
    """

    @property
    def time_s(self) -> Array:
        """See above."""
        ...

    @property
    def rows(self) -> Array:
        """See above."""
        ...

    def at(self, time_s: Array, value: int, rate: int) -> Array:
        """A column between the instants, from its values and those of its rate."""
        ...


class FarEnd:
    """A simulated device; this one is silent."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take what the host sends; returns what the device answers at once."""
        return b""

    def step(self, now_s: float) -> bytes:
        """What it does by itself before the rig moves on from now: mechanisms, control loops, reports."""
        return b""

    def sample(self, motion: Stretch) -> bytes:
        """What it sends of a stretch of motion."""
        return b""

    def fail(self, what: str, value: Any) -> None:
        """Something goes wrong with it, or is mended.

        Raises:
            ValueError: no such fault.
        """
        raise ValueError(f"this device knows no fault {what!r}")

    def facts(self) -> Mapping[str, Any]:
        """What a test may know of it that no byte says."""
        return {}
