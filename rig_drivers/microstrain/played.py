"""Stand-in for a MicroStrain node and its base station of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from daq.errors import LogError
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.far_end import SimulatedMicroStrain
from rig_drivers.microstrain.settings import MicroStrainNode


class PlayedMicroStrain(PlayedDevice):
    """A base station and a node that answer as those of the log.

    Queries of the beacon's time are not answered: the log contains the answers that belong to its samples.

    Args:
        identity: identity of the node from its opening. Missing entries are taken from the rig file.
        settings: table of the node in the rig file.

    Raises:
        LogError: the identity is impossible for such a node.
    """

    expects = "the start of synchronized sampling"

    def __init__(self, settings: MicroStrainNode, identity: Mapping[str, Any]) -> None:
        super().__init__()
        serial = str(identity.get("serial") or settings.serial or "0-0-0")
        try:
            model, option, number = (int(part) for part in serial.split("-"))
        except ValueError as error:
            raise LogError(f"identities.json: expected a serial like 6305-1000-12345, got {serial!r:.80}") from error
        if not (0 <= model < 2**16 and 0 <= option < 2**16 and 0 <= number < 2**32):
            raise LogError(f"identities.json: the serial {serial!r:.80} is impossible for a node")
        self._node = SimulatedMicroStrain.unmoved(settings, model, option, number)
        self._status = wire.request(settings.aspp, wire.BASE_ADDRESS, wire.BEACON_STATUS)

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._node.streaming

    def begin(self) -> None:
        """See PlayedDevice."""
        self._node.start()

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        self.commands += 1
        return self._node.receive(data.replace(self._status, b""), 0.0) + self._node.step(1.0)
