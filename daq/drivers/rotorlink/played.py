"""Stand-in for a RotorLink node of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.settings import EncoderNode


class PlayedNode(PlayedDevice):
    """The on-rotor node. It sends without a command; commands are neither carried out nor acknowledged.

    Args:
        settings, identity: of the node; they are not needed.
    """

    def __init__(self, settings: EncoderNode, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._frames = FrameDecoder()

    @override
    def hear(self, data: bytes) -> bytes:
        commands = sum(isinstance(frame, rotorlink.NodeCommand) for frame in self._frames.feed(data).frames)
        self.commands += commands
        self.unfollowed += commands
        return b""
