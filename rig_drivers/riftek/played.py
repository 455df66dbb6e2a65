"""Stand-in for an RF60x sensor of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from daq.errors import LogError
from rig_drivers.riftek.far_end import SimulatedRiftek
from rig_drivers.riftek.settings import RiftekLaser


class PlayedRiftek(PlayedDevice):
    """An RF60x sensor that answers as the sensor of the log. Commands do not change the bytes of the log.

    Args:
        identity: identity of the sensor from its opening. Missing entries are taken from the rig file.
        settings: table of the sensor in the rig file.

    Raises:
        LogError: the identity is impossible for such a sensor.
    """

    expects = "the start of the stream"

    def __init__(self, settings: RiftekLaser, identity: Mapping[str, Any]) -> None:
        super().__init__()
        range_m = identity.get("told_range_m", identity.get("range_m", settings.range_m))
        serial = str(identity.get("serial", "0"))
        if not isinstance(range_m, int | float) or not 0 < range_m < 65.536 or not serial.isdecimal():
            raise LogError(f"identities.json: expected range and serial number of an RF60x, got {dict(identity)!r:.80}")
        reported = settings.model_copy(update={"range_m": float(range_m)})
        self._sensor = SimulatedRiftek.unmoved(reported, serial)

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._sensor.streaming

    def begin(self) -> None:
        """See PlayedDevice."""
        self._sensor.streaming = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        self.commands += sum(byte < 0x80 for byte in data)
        return self._sensor.receive(data)
