# pyright: strict
"""A device of a log at the far end of a port while the log is played: its bytes, and answers to what it is told.

A device that a host configures first behaves as it would: it is silent until it is told to send. Whatever is asked is
answered as the device of the log would answer; whatever would change its bytes is refused, or, where there is no way to
refuse, let pass and counted.
"""

from __future__ import annotations

from typing import Protocol

from daq.channels import RX


class BytesFromDevice(Protocol):
    """Turns what was recorded into what is played."""

    def feed(self, direction: int, data: bytes) -> bytes:
        """Bytes to play for bytes that went one way or the other."""
        ...

    def rest(self) -> bytes:
        """What is still to be played when nothing follows."""
        ...


class OneWay:
    """A serial line has a pair of wires: one who listens to the device does not hear what it is told."""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        return data if direction == RX else b""

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        return b""


class PlayedDevice:
    """One device of a log while it is played. This one needs no set-up and takes no commands; others are kinds of it.

    Attributes:
        expects: what it must be told before it sends; empty when it sends by itself.
        commands: how many it has heard.
        unfollowed: how many of them asked for what a log cannot do.
        withheld_bytes: of the log, while it was not told to send.

    Args:
        source: which bytes of the log are its.
    """

    expects = ""

    def __init__(self, source: BytesFromDevice | None = None) -> None:
        self.commands = self.unfollowed = self.withheld_bytes = 0
        self._source = source or OneWay()

    @property
    def sending(self) -> bool:
        """Whether its bytes go out."""
        return True

    def begin(self) -> None:
        """Send from now on, whatever it was told: whoever listens configures nothing."""

    def hear(self, data: bytes) -> bytes:
        """Take what the host sends; returns the answer."""
        return b""

    def play(self, direction: int, data: bytes) -> bytes:
        """What goes out now of bytes of the log; between two calls an answer may stand."""
        return self._pass(self._source.feed(direction, data))

    def rest(self) -> bytes:
        """What goes out when nothing follows."""
        return self._pass(self._source.rest())

    def _pass(self, data: bytes) -> bytes:
        if self.sending:
            return data
        self.withheld_bytes += len(data)
        return b""
