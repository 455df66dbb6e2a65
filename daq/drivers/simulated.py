"""The far end of a device's line: the simulated device that sends and receives the bytes of the real one.

A far end has the device's codec and a motion of the rig. It opens no port and reads no clock. Times are rig time, s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


class MotionInterval(Protocol):
    """Motion of the rig over a short interval.

    Attributes:
        time_s: instants, s, shape (n,).
        rows: x, y, θ3, θ4, their rates, ψ and its rate at each instant, shape (n, 10); m, rad, s.
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
        """Interpolate a column at times between the instants.

        Args:
            time_s: times, s.
            value: index of the column.
            rate: index of the column with its rate.
        """
        ...


@dataclass(frozen=True)
class FaultKind:
    """A fault of a simulated device.

    Attributes:
        words: description, a sentence without its full stop.
        value: default value for `FarEnd.fail`.
        end: value that ends the fault; None if it happens once or lasts until the host has reset it.
        meaning: meaning of the value, with its unit; empty if the fault is only on or off.
        limits: smallest and largest value.
    """

    words: str
    value: float = 1
    end: float | None = 0
    meaning: str = ""
    limits: tuple[float, float] = (0, 1)


class FarEnd:
    """Base class of simulated devices; it sends nothing.

    Attributes:
        fault_kinds: faults of the device, by the name that `fail` takes.
        line_alive: whether the line carries bytes; otherwise the rig drops them.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {}
    line_alive: bool = True

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host and return the bytes that the device answers immediately."""
        return b""

    def step(self, now_s: float) -> bytes:
        """Update mechanisms and control loops before the rig advances from `now_s`; return reports that are due."""
        return b""

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the bytes that the device sends for an interval of motion."""
        return b""

    def fail(self, what: str, value: Any) -> None:
        """Start, change or end a fault.

        Args:
            what: name of the fault, a key of `fault_kinds`.
            value: see FaultKind.

        Raises:
            ValueError: the device has no such fault.
        """
        raise ValueError(f"this device has no fault {what!r}")

    def power(self, on: bool, now_s: float) -> None:
        """Switch the supply off, or on at `now_s`. A device starts again when its supply returns.

        The base class becomes silent and continues where it was. `step` and `sample` are also called without supply.
        """
        self.line_alive = on

    def facts(self) -> Mapping[str, Any]:
        """Return internal state for tests that the bytes do not contain."""
        return {}
