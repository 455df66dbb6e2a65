"""A simulated optoNCDT 2300 on Ethernet: it sends packets as soon as a program is connected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.simulated import FaultKind
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.free_sensor import FreeSensor
from rig_drivers.optoncdt_ethernet import distances, wire
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser

_ORDER = 4120175


class SimulatedEthernetLaser(FreeSensor):
    """One sensor; see FreeSensor."""

    first_serial: ClassVar[int] = 230_000
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every distance is the code for no peak"),
        "dropped": FaultKind("frames are dropped before they are sent", 100, None, "how many", (0, 1e6)),
        "other": FaultKind("it is another sensor", 999, None, "its serial number", (1, 2**32 - 1)),
    }

    def __init__(self, settings: EthernetLaser, beam: Beam, serial: int) -> None:
        super().__init__(settings, beam, serial)
        self._settings = settings
        self._codes = distances.codes_of(settings.scaling)
        self._counter = int(beam.rng.integers(0, wire.COUNTER_WRAP))  # of the next frame, or packet
        self._flags = wire.flags_of(settings.words)

    def packets(self, reading: NDArray[np.floating], numbers: NDArray[np.int64]) -> bytes:
        """Return the packet with the samples in an interval of motion."""
        words = self._words(reading, numbers)
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

    @override
    def begin(self) -> None:
        self._counter = 0
