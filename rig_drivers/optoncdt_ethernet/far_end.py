"""A simulated optoNCDT 2300 on Ethernet: it sends packets as soon as a program is connected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World
from rig_drivers.optoncdt_ethernet import distances, wire
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser

_ORDER = 4120175


class SimulatedEthernetLaser(FarEnd):
    """One sensor.

    Args:
        settings: table of the sensor in the rig file.
        beam: its beam.
        serial: serial number, if the rig file states none.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every distance is the code for no peak"),
        "dropped": FaultKind("frames are dropped before they are sent", 100, None, "how many", (0, 1e6)),
        "other": FaultKind("it is another sensor", 999, None, "its serial number", (1, 2**32 - 1)),
    }

    def __init__(self, settings: EthernetLaser, beam: Beam, serial: int) -> None:
        self._settings, self._beam = settings, beam
        self._serial = settings.serial_number or serial
        self._codes = distances.codes_of(settings.scaling)
        self._counter = int(beam.rng.integers(0, wire.COUNTER_WRAP))  # of the next frame, or packet
        self._flags = wire.flags_of(settings.words)
        self._blocked = False
        self._drop = 0

    @classmethod
    def of(cls, device: str, settings: EthernetLaser, world: World) -> SimulatedEthernetLaser:
        """Make the sensor of a simulated rig."""
        return cls(settings, Beam.of(device, settings, world), 230_000 + world.number(device, settings.topic))

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the packet with the samples in an interval of motion."""
        period_s = 1.0 / self._settings.rate_Hz
        numbers = self._beam.due(motion, period_s)
        if not len(numbers):
            return b""
        words = self._words(self._beam.reading(motion, numbers * period_s), numbers)
        of_frames = self._settings.counts == "frames"
        dropped = min(self._drop, len(words))
        self._drop -= dropped
        if of_frames or dropped == len(words):
            self._counter += dropped if of_frames else 1
        words = words[dropped:]
        if not len(words):
            return b""
        packet = wire.Packet(_ORDER, self._serial, self._flags, self._counter % wire.COUNTER_WRAP, words)
        self._counter += len(words) if of_frames else 1
        return wire.encode(packet)

    def _words(self, reading: NDArray[np.floating], numbers: NDArray[np.int64]) -> NDArray[np.uint32]:
        half = 0.5 * self._settings.range_m
        code = distances.code(np.clip(reading, -half, half) + half, self._settings.range_m, self._settings.scaling)
        outside = np.where(reading > half, self._codes["behind"], self._codes["before"])
        code = np.where(np.abs(reading) > half, outside, code).astype(np.uint32)
        if self._blocked:
            code[:] = self._codes["no peak"]
        words = np.tile((numbers % 2**16).astype(np.uint32)[:, None], (1, len(self._settings.words)))
        words[:, self._settings.words.index("DIST")] = code
        return words

    def fail(self, what: str, value: Any = 1) -> None:
        """See FarEnd and `fault_kinds`."""
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
            self._counter = 0
            self._beam.power_up(now_s)
