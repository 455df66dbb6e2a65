"""A simulated displacement sensor on a network: it sends packets as soon as it has power, and takes no commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.simulated import FarEnd, MotionInterval
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World


class FreeSensor(FarEnd, ABC):
    """One sensor. A subclass makes its packets.

    Args:
        settings: table of the sensor in the rig file, with `serial_number` (0: none is stated) and `rate_Hz`.
        beam: its beam.
        serial: serial number, if the rig file states none.

    Attributes:
        first_serial: serial number of the first sensor of a rig without stated ones.
    """

    first_serial: ClassVar[int] = 1

    def __init__(self, settings: Any, beam: Beam, serial: int) -> None:
        self._beam, self._period_s = beam, 1.0 / settings.rate_Hz
        self._serial: int = settings.serial_number or serial
        self._blocked = False
        self._drop = 0  # number of frames or packets that are lost next

    @classmethod
    def of(cls, device: str, settings: Any, world: World) -> Self:
        """Make the sensor of a simulated rig."""
        return cls(settings, Beam.of(device, settings, world), cls.first_serial + world.number(device, settings.topic))

    @abstractmethod
    def packets(self, reading: NDArray[np.floating], numbers: NDArray[np.int64]) -> bytes:
        """Return the packets that are full after further samples; see Beam for the arguments, shape (n,), n ≥ 1."""

    @abstractmethod
    def begin(self) -> None:
        """Count from 0, as after power-up."""

    @override
    def sample(self, motion: MotionInterval) -> bytes:
        numbers = self._beam.due(motion, self._period_s)
        if not len(numbers):
            return b""
        return self.packets(self._beam.reading(motion, numbers * self._period_s), numbers)

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        match what:
            case "blocked":
                self._blocked = bool(value)
            case "dropped":
                self._drop = int(value)
            case "other":
                self._serial = int(value)
            case _:
                super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. After power-up the sensor counts from 0."""
        super().power(on, now_s)
        if on:
            self.begin()
            self._beam.power_up(now_s)
