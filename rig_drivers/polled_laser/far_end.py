"""A simulated displacement sensor that answers one value to one request.

Stand-in for a polled displacement sensor of a log while the log is played.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser

_ANSWER_S = 0.003  # from the request to the answer, s; the value is measured in the middle


class SimulatedPolledLaser(FarEnd):
    """One sensor on its serial line.

    Args:
        settings: table of the sensor in the rig file.
        beam: its beam.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every answer is the text without a value"),
        "deaf": FaultKind("it ignores every request"),
        "refuses": FaultKind("it refuses every request (not HL-G1)"),
    }

    def __init__(self, settings: PolledLaser, beam: Beam) -> None:
        self._settings, self._beam = settings, beam
        self._dialect = wire.DIALECTS[settings.dialect]
        self._request = bytearray()
        self._asked: list[tuple[float, bytes]] = []  # rig time and text of requests that are not measured yet
        self._measured: list[tuple[float, bytes]] = []  # rig time and text of answers that are not sent yet
        self._faults: dict[str, bool] = dict.fromkeys(self.fault_kinds, False)

    @classmethod
    def of(cls, device: str, settings: PolledLaser, world: World) -> SimulatedPolledLaser:
        """Make the sensor of a simulated rig."""
        return cls(settings, Beam.of(device, settings, world))

    def receive(self, data: bytes, now_s: float = 0.0) -> bytes:
        """Take request bytes, split at any place. The answers follow with the samples."""
        for byte in data:
            self._request.append(byte)
            if byte == 0x0D:
                if not self._faults["deaf"]:
                    self._asked.append((now_s, bytes(self._request)))
                self._request.clear()
        del self._request[: -wire.LONGEST_LINE_BYTES]
        return b""

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the answers that are due in an interval of motion."""
        until_s = float(motion.time_s[-1])
        while self._asked and self._asked[0][0] + 0.5 * _ANSWER_S <= until_s:
            asked_s, request = self._asked.pop(0)
            device_s = np.atleast_1d(self._beam.clock.device_s(asked_s + 0.5 * _ANSWER_S))
            answer = self._answer(request, float(self._beam.reading(motion, device_s)[0]))
            self._measured.append((asked_s + _ANSWER_S, answer))
        due = [answer for due_s, answer in self._measured if due_s <= until_s]
        self._measured = self._measured[len(due) :]
        return b"".join(due)

    def _answer(self, request: bytes, reading_m: float) -> bytes:
        if self._faults["refuses"] and self._settings.dialect != "HL-G1":
            return b"ER,%s,01\r" % request[:2]
        if request == self._dialect.probe(self._settings.output):
            return self._dialect.probe_answer(self._settings.output)
        half = 0.5 * self._settings.range_m
        value = reading_m / self._settings.metres_per_unit
        state = "nothing" if self._faults["blocked"] else ""
        if not state and abs(reading_m) > half:
            state = "over" if value > 0 else "under"
        shown = wire.Reading(math.nan if state else value, state)
        return self._dialect.answer(request, self._settings.output, shown) or b""

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        if what not in self._faults:
            super().fail(what, value)
        self._faults[what] = bool(value)

    @override
    def power(self, on: bool, now_s: float) -> None:
        super().power(on, now_s)
        self._asked.clear()
        self._measured.clear()
        self._request.clear()


class PlayedPolledLaser(PlayedDevice):
    """A sensor that answers the opening dialogue with 0, and then plays the answers of the log at their times.

    Args:
        settings: table of the sensor in the rig file.
        identity: of the sensor; it is not needed.
    """

    expects = "a request"

    def __init__(self, settings: PolledLaser, identity: Mapping[str, Any]) -> None:
        super().__init__(sends=False)
        self._settings, self._dialect = settings, wire.DIALECTS[settings.dialect]

    @override
    def hear(self, data: bytes) -> bytes:
        if self._sends:  # the values follow from the log
            is_probe = data == self._dialect.probe(self._settings.output)
            return self._dialect.probe_answer(self._settings.output) if is_probe else b""
        self.commands += 1
        self._sends = True
        return self._dialect.answer(data, self._settings.output, wire.Reading(0.0)) or b""
