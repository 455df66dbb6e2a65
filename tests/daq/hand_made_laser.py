"""A sensor whose answers are written by hand, and a host's way to it."""

from __future__ import annotations

import queue
from collections.abc import Mapping
from typing import Any

from daq.drivers.optoncdt import dialogue, wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.lockstep.clock import SimulatedClock


class HandMadeLaser:
    """Answers every command with "ok", but for those that are given; also a Talk.

    Args:
        name, range_mm: in the answer to GETINFO.
        outinfo: lines of the answer to GETOUTINFO_RS422.
        answers: first line of the answer by command, with or without its parameters.

    Attributes:
        heard: commands as they came.
    """

    def __init__(
        self,
        name: str = "ILD1420-25",
        range_mm: str = "25.00",
        outinfo: str = "GETOUTINFO_RS422 DIST1 COUNTER TIMESTAMP",
        answers: Mapping[str, str] | None = None,
    ) -> None:
        self.clock = SimulatedClock()
        self.replies: queue.Queue[str] = self.clock.queue()
        self.bytes_in = 0
        self.heard: list[str] = []
        info = f"Name: {name}\r\nSerial: 12345678\r\nMeasuring range: {range_mm}mm\r\nVersion: 001.005"
        self._answers = {"GETINFO": info, "GETOUTINFO_RS422": outinfo, **(answers or {})}
        self._decoder = optoncdt.BlockDecoder(("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"))

    def send(self, data: bytes) -> None:
        for command in data.decode("ascii").splitlines():
            self.heard.append(command)
            answer = self._answers.get(command, self._answers.get(command.split()[0], f"{command} ok"))
            answer = f"{answer}\r\n->".encode()
            self.bytes_in += len(answer)
            for line in self._decoder.feed(answer).text:
                self.replies.put(line)

    def restart_decoding(self) -> None:
        pass

    def set_up(self, **settings: Any) -> dict[str, Any]:
        """The identity that our own set-up finds; the sensor's table of the rig file has these settings."""
        table = {"driver": "optoncdt", "port": "p", "axis": "x", **settings}
        return dialogue.configure("laser_x", Laser.model_validate(table), self)
