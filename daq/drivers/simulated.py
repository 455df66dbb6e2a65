# pyright: strict
"""The far end of a device's line: what speaks its bytes when the rig is simulated.

A far end knows the device's wire and a motion; it knows no port and reads no clock. Time is the rig's, s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

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


@dataclass(frozen=True)
class FaultKind:
    """Something that can go wrong with a simulated device.

    Attributes:
        words: what happens, a sentence without its full stop.
        value: what `FarEnd.fail` takes where nobody asks for another value.
        end: the value that ends it; None where it happens once, or lasts until the host has mended it.
        meaning: of the value, with its unit; empty where it is only on or off.
        limits: smallest and largest value.
    """

    words: str
    value: float = 1
    end: float | None = 0
    meaning: str = ""
    limits: tuple[float, float] = (0, 1)


class FarEnd:
    """A simulated device; this one is silent.

    Attributes:
        fault_kinds: what can go wrong with it, by the words that `fail` takes.
        line_alive: whether its line carries bytes; the rig drops them where it does not.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {}
    line_alive: bool = True

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

    def power(self, on: bool, now_s: float) -> None:
        """Its supply fails, or comes back at now_s: then it begins anew, as the device does.

        This one falls silent and goes on where it was. `step` and `sample` are called without supply, too.
        """
        self.line_alive = on

    def facts(self) -> Mapping[str, Any]:
        """What a test may know of it that no byte says."""
        return {}
