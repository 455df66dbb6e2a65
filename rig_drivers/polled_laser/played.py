"""Stand-in for a polled displacement sensor of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser


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

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        if self._sends:  # the values follow from the log
            is_probe = data == self._dialect.probe(self._settings.output)
            return self._dialect.probe_answer(self._settings.output) if is_probe else b""
        self.commands += 1
        self._sends = True
        return self._dialect.answer(data, self._settings.output, wire.Reading(0.0)) or b""
