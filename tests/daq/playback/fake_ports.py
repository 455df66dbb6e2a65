"""Ports of a playback, and its clock, without machinery: a program at the other end that a test scripts."""

from __future__ import annotations

import math
from collections.abc import Callable

from daq.errors import LinkLost


class FakePort:
    """One end of a port: bytes that the program there sends next, and bytes that it received.

    Args:
        room: most bytes that it accepts in one offer.
        goes_after: bytes after which it goes away.
    """

    port = "fake"

    def __init__(self, room: int = 10**9, goes_after: int = 10**12) -> None:
        self.room, self.goes_after = room, goes_after
        self.next_bytes, self.got, self.open = b"", b"", True

    def offer(self, data: bytes) -> int:
        self.open = self.open and len(self.got) < self.goes_after
        if not self.open:
            raise LinkLost("gone")
        self.got += data[: self.room]
        return min(self.room, len(data))

    def receive(self) -> bytes:
        sent, self.next_bytes = self.next_bytes, b""
        return sent

    def connected(self) -> bool:
        return self.open

    def descriptor(self) -> int | None:
        return None

    def close(self) -> None:
        self.open = False


class FakeClock:
    """A clock that advances only by sleeping or explicitly.

    Attributes:
        does: called after each sleep with the time that has passed, s: what a program at the other end does then.
    """

    def __init__(self, does: Callable[[float], object] = lambda at_s: None) -> None:
        self.ns = 5_000_000_000
        self.slept: list[float] = []
        self.does = does

    def now_ns(self) -> int:
        return self.ns

    def wait(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.ns += math.ceil(seconds * 1e9)
        self.does(self.ns * 1e-9 - 5)
