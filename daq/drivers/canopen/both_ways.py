"""The frames of both directions on a CAN bus while a log is played."""

from __future__ import annotations

from daq.channels import RX
from daq.transports import slcan

_LINE_ENDS = b"\r\x07"
_MAX_TAIL_BYTES = 4096  # bytes without an end of line that are held back


class BothWays:
    """Filter for a CAN bus, which carries both directions: the host's frames are inserted between the nodes' lines.

    A read may end in the middle of a line. The incomplete line is held until its end, so that no frame of the host is
    inserted into it; the node's line was not complete before that frame either. Commands of the host to its own
    adapter (open, close, bit rate) are not on the bus and are not played.

    Args:
        replaced: identifier of the frames that every host sends periodically: its heartbeat, or SYNC.

    Attributes:
        host_is_there: whether a host has replaced the recorded one; then the recorded frames `replaced` are omitted.
    """

    def __init__(self, replaced: int) -> None:
        self.host_is_there = False
        self._replaced = replaced
        self._host = slcan.LineDecoder(of_host=True)
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            frames = self._host.feed(data).frames
            omitted = self._replaced if self.host_is_there else None
            return b"".join(slcan.encode(frame) for frame in frames if frame.arbitration_id != omitted)
        line = self._tail + data
        end = 1 + max(line.rfind(_LINE_ENDS[:1]), line.rfind(_LINE_ENDS[1:]))
        if len(line) - end > _MAX_TAIL_BYTES:
            end = len(line)
        self._tail = line[end:]
        return line[:end]

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        tail, self._tail = self._tail, b""
        return tail
