"""A simulated RF60x sensor on Ethernet: it sends its packets without a command."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.simulated import FaultKind
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.free_sensor import FreeSensor
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser

_RESULTS, _BASE_MM, _FULL = 168, 80, 16384


class SimulatedRiftekEthernet(FreeSensor):
    """One sensor; see FreeSensor."""

    first_serial: ClassVar[int] = 19_000
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every result is 0"),
        "dropped": FaultKind("packets are lost on the network", 10, None, "how many", (0, 1e4)),
        "repeats": FaultKind("every packet arrives twice"),
        "other": FaultKind("it is another sensor", 999, None, "its serial number", (0, 65535)),
    }

    def __init__(self, settings: RiftekEthernetLaser, beam: Beam, serial: int) -> None:
        super().__init__(settings, beam, serial)
        self._settings = settings
        self._number = int(beam.rng.integers(0, 256))
        self._pending: list[int] = []
        self._repeats = False

    def packets(self, reading: NDArray[np.floating], numbers: NDArray[np.int64]) -> bytes:
        """Return the packets that are full at the end of an interval of motion."""
        self._pending += self._codes(reading).tolist()
        out = b""
        while len(self._pending) >= _RESULTS:
            codes, self._pending = self._pending[:_RESULTS], self._pending[_RESULTS:]
            packet = self._packet(codes)
            dropped, self._drop = self._drop > 0, max(0, self._drop - 1)
            out += b"" if dropped else packet * (2 if self._repeats else 1)
        return out

    def _codes(self, reading: NDArray[np.floating]) -> NDArray[np.int64]:
        share = reading / self._settings.range_m + 0.5
        codes = np.where((share < 0) | (share > 1), 0, np.rint(share * _FULL)).astype(np.int64)
        return np.zeros_like(codes) if self._blocked else codes

    def _packet(self, codes: list[int]) -> bytes:
        data = b"".join(struct.pack("<HB", code, 0) for code in codes)
        data += struct.pack("<HHHB", self._serial, _BASE_MM, self._settings.range_mm, self._number % 256)
        self._number += 1
        mixed = 0
        for byte in data:
            mixed ^= byte
        return data + bytes(({"sum": sum(data) & 0xFF, "xor": mixed, "none": 0}[self._settings.checksum],))

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        if what == "repeats":
            self._repeats = bool(value)
        else:
            super().fail(what, value)

    @override
    def begin(self) -> None:
        self._number, self._pending = 0, []
