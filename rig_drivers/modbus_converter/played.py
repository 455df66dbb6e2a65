"""Stand-in for a converter of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from rig_drivers.modbus_converter.far_end import RegisterServer, initial_words
from rig_drivers.modbus_converter.settings import ModbusConverter


class PlayedConverter(PlayedDevice):
    """A converter that answers the opening dialogue and all writes; its speed is that of the log.

    Its reports are those of the log: the reads of state and speed are answered only before the first byte is played.

    Args:
        settings: table of the converter in the rig file.
        identity: of the converter; it is not needed.
    """

    def __init__(self, settings: ModbusConverter, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._settings = settings
        self._began = False
        self._server = RegisterServer(settings, initial_words(settings), self._written, self._reads)

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answers = self._server.receive(data)
        self.commands: int = self._server.requests
        return answers

    def _reads(self, register: int, count: int) -> bool:
        return not (self._began and (register, count) in self._settings.blocks)

    def _written(self, register: int, value: int) -> int:
        r = self._settings.registers
        self.unfollowed += register == r.control and value in (r.run, r.run_reverse)
        return 0

    def play(self, direction: int, data: bytes) -> bytes:
        """See PlayedDevice."""
        self._began = True
        return super().play(direction, data)
