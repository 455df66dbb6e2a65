"""Stand-in for CANopen encoders of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.can_lines import PlayedOnBus
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import Node
from daq.errors import LogError
from daq.transports.can_frames import CanFrame
from rig_drivers.cia406 import wire
from rig_drivers.cia406.node_objects import encoder_objects
from rig_drivers.cia406.settings import FAULT_KEYS, Encoder, EncoderBus

_OTHER_OBJECT = 0x2000_0000  # entry of a PDO's mapping for a manufacturer-specific object, without its bits


class PlayedEncoders(PlayedOnBus):
    """Encoders that answer the opening and follow network commands; their positions come at the times of the log.

    The recorded SYNCs are played until a host sends its own ones. A position then counts as sampled at the newest SYNC
    of that host, up to one period away from its own time.

    Args:
        settings: table of the encoders in the rig file.
        identity: identity of the encoders from their opening.

    Raises:
        LogError: the identity is impossible.
    """

    expects = "the network's start"

    def __init__(self, settings: EncoderBus, identity: Mapping[str, Any]) -> None:
        super().__init__({cia301.COB_SYNC})
        self._nodes = [_node(encoder, settings, identity) for encoder in settings.encoders]

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return super().sending and all(node.operational for node in self._nodes)

    def begin(self) -> None:
        """See PlayedDevice."""
        super().begin()
        for node in self._nodes:
            node.state = cia301.Heartbeat.OPERATIONAL

    def is_command(self, frame: CanFrame) -> bool:
        """See PlayedOnBus. SYNC does not count."""
        return not self.is_host(frame)

    def is_host(self, frame: CanFrame) -> bool:
        """See PlayedOnBus."""
        return frame.arbitration_id == cia301.COB_SYNC

    def answers(self, frame: CanFrame) -> list[CanFrame]:
        """See PlayedOnBus."""
        return [answer for node in self._nodes for answer in node.answers(frame)]


def _node(encoder: Encoder, settings: EncoderBus, identity: Mapping[str, Any]) -> Node:
    """Return an encoder of the log."""
    per_turn = settings.counts_per_revolution
    name = encoder.name
    defaults = {"serial": encoder.serial, "positions": per_turn, "counter_clockwise": 0, "maker": 0, "product": 0}
    defaults |= dict.fromkeys((*FAULT_KEYS, "offset"), 0)
    known = {key: identity.get(f"{name}_{key}", value) for key, value in defaults.items()}
    if not all(type(value) is int and 0 <= value < 2**32 for value in known.values()):
        raise LogError(f"identity of encoder {name}: expected numbers of 32 bits, got {known!r:.200}")
    parameters = 0x4 | (known["counter_clockwise"] & 1)
    objects = encoder_objects(encoder.node, known["serial"], per_turn, known["positions"], parameters)
    objects[cia301.IDENTITY, 1], objects[cia301.IDENTITY, 2] = (known["maker"], "<I"), (known["product"], "<I")
    register, code, alarms, warnings = (known[key] for key in FAULT_KEYS)
    objects[cia301.ERROR_REGISTER, 0] = (register & 0xFF, "<B")
    objects[cia301.PREDEFINED_ERROR_FIELD, 1] = (code, "<I")
    objects[wire.ALARMS, 0], objects[wire.WARNINGS, 0] = (alarms & 0xFFFF, "<H"), (warnings & 0xFFFF, "<H")
    node = Node(encoder.node, objects)
    if offset := known["offset"]:  # its reports in the log contain something else before the position
        objects[cia301.TPDO1_MAPPING, 0] = (2, "<B")
        objects[cia301.TPDO1_MAPPING, 1] = (_OTHER_OBJECT | 8 * offset & 0xFF, "<I")
        objects[cia301.TPDO1_MAPPING, 2] = (wire.POSITION_MAPPED, "<I")
        node.sdo.fixed.add((cia301.TPDO1_MAPPING, 0))
    return node
