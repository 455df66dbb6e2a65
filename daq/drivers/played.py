"""Stand-in for a device of a log at the far end of a port while the log is played.

It sends the bytes of the log and answers commands. A device that a host configures first is silent until it is
commanded to send. Queries are answered as the device of the log would answer. Commands that would change the bytes of
the log are refused. If the protocol has no refusal, they are ignored and counted.
"""

from __future__ import annotations

from typing import Protocol

from typing_extensions import override

from daq.channels import RX


class BytesFromDevice(Protocol):
    """Filter from recorded bytes to the bytes that are played."""

    def feed(self, direction: int, data: bytes) -> bytes:
        """Return the bytes to play for recorded bytes of one direction."""
        ...

    def remainder(self) -> bytes:
        """Return the remaining bytes to play at the end of the log."""
        ...


class OneWay(BytesFromDevice):
    """Filter for a serial line with one wire for each direction: only the device's bytes are played."""

    @override
    def feed(self, direction: int, data: bytes) -> bytes:
        return data if direction == RX else b""

    @override
    def remainder(self) -> bytes:
        return b""


class PlayedDevice:
    """One device of a log while it is played. This base class needs no set-up and ignores commands.

    Attributes:
        expects: description of the command after which it sends; empty if it sends without a command.
        commands: number of received commands.
        unfollowed: number of received commands that a log cannot follow.
        withheld_bytes: number of bytes of the log that were not sent because no command to send had come.

    Args:
        source: filter that selects the device's bytes from those of the log.
        sends: whether it sends without a command.
    """

    expects = ""

    def __init__(self, source: BytesFromDevice | None = None, *, sends: bool = True) -> None:
        self.commands = self.unfollowed = 0
        self.withheld_bytes: int = 0
        self._source = source or OneWay()
        self._sends = sends

    @property
    def sending(self) -> bool:
        """Whether the bytes of the log are sent."""
        return self._sends

    def begin(self) -> None:
        """Send from now on without a command: a host that only receives does not configure the device."""
        self._sends = True

    def hear(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answer."""
        return b""

    def play(self, direction: int, data: bytes) -> bytes:
        """Return the bytes to send now for bytes of the log. An answer may be inserted between two calls."""
        return self._pass(self._source.feed(direction, data))

    def remainder(self) -> bytes:
        """Return the remaining bytes to send at the end of the log."""
        return self._pass(self._source.remainder())

    def _pass(self, data: bytes) -> bytes:
        if self.sending:
            return data
        self.withheld_bytes += len(data)
        return b""
