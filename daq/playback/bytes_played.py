"""Which bytes of a log a listener on the line would have seen."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from daq.channels import RX
from daq.transports import slcan

_LINE_ENDS = b"\r\x07"
_TAIL_BYTES = 4096  # noise without an end of line is held back no longer than this


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


class WholeBlocks:
    """A sensor's stream, handed on in whole blocks, so that an answer in between never falls into one.

    What follows the last whole block waits for its end, but no longer than a block is: then it is none.

    Args:
        words: values in a block.
    """

    def __init__(self, words: int) -> None:
        self._words = words
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            return b""
        line = self._tail + data
        end = self._end_of_blocks(line)
        if len(line) - end > 3 * self._words:
            end = len(line)
        self._tail = line[end:]
        return line[:end]

    def _end_of_blocks(self, line: bytes) -> int:
        """Where the last whole block ends; where the block under way begins, when there is none behind it."""
        high = np.flatnonzero(np.frombuffer(line, np.uint8) >= 0x80)  # last bytes of values …
        first = np.flatnonzero(np.frombuffer(line, np.uint8)[high] < 0xC0)  # … and those that begin a block
        if not len(first):
            return 0
        begun = int(first[-1])
        ended = begun + self._words - 1
        return int(high[ended]) + 1 if ended < len(high) else max(0, int(high[begun]) - 2)

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        tail, self._tail = self._tail, b""
        return tail


class BothWays:
    """A CAN bus carries both: frames of the host stand between those of the drive, line by line.

    A read may end in the middle of a line. Its beginning waits for its end, so that no frame of the host falls into it;
    the drive's line was not complete before that frame went out either. What the host told its own adapter (open,
    close, bit rate) is not on the bus and not played.
    """

    def __init__(self) -> None:
        self._host = slcan.LineDecoder()
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            return b"".join(slcan.encode(frame) for frame in self._host.feed(data).frames)
        line = self._tail + data
        end = 1 + max(line.rfind(_LINE_ENDS[:1]), line.rfind(_LINE_ENDS[1:]))
        if len(line) - end > _TAIL_BYTES:
            end = len(line)
        self._tail = line[end:]
        return line[:end]

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        tail, self._tail = self._tail, b""
        return tail
