# pyright: strict
"""A RotorLink node of a log while it is played."""

from __future__ import annotations

from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink import wire as rotorlink


class PlayedNode(PlayedDevice):
    """The on-rotor node: sends by itself; a command is neither carried out nor acknowledged."""

    def __init__(self) -> None:
        super().__init__()
        self._frames = rotorlink.FrameDecoder()

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        asked = sum(isinstance(frame, rotorlink.Command) for frame in self._frames.feed(data).frames)
        self.commands += asked
        self.unfollowed += asked
        return b""
