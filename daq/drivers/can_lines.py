"""Parts that drivers of devices on a CAN bus have in common: the text of the slcan adapter, for host and far end.

`CanLines` decodes the text in pipelines. `Adapter` is the adapter's own end of the line in simulated devices and in
stand-ins for playing, `BothWays` the filter of the latter. Source: LAWICEL CAN232 manual.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Iterable

from daq.channels import RX
from daq.items import DeviceEvent
from daq.transports import slcan
from rig_basics.texts import number_of

ADAPTER_BAUD = 115_200
"""Line rate of an adapter's serial port, baud; an adapter with USB ignores it."""

_RATES = {125_000: b"S4", 250_000: b"S5", 500_000: b"S6", 1_000_000: b"S8"}
_LINE_ENDS = b"\r\x07"
_AGAIN_NS = 1_000_000_000
_KEPT_FRAMES = 64  # sent frames with which a received command is compared
_HEARTBEATS, _BOOT_UP = 0x700, b"\x00"  # identifiers of CANopen heartbeats, and the first one of a node
_MAX_TAIL_BYTES = 4096  # bytes without an end of line that are held back


def open_bus(bitrate: int) -> bytes:
    """Return the commands to an adapter that open the bus at a bit rate, bit/s; an open bus is closed first."""
    return b"\rC\r" + _RATES[bitrate] + b"\rO\r"


CLOSE_BUS = b"C\r"
"""Command to an adapter that closes the bus: it sends nothing afterwards."""


class CanLines:
    """Decoder of the adapter's text in both directions to frames. The line in which a log begins is not counted.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline; this decoder adds and counts `damaged_lines` and `refused_lines`.

    Attributes:
        open_refused: whether the adapter has refused the last command to open the bus that it has answered.
    """

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        self._device, self._losses = device, losses
        losses |= {"damaged_lines": 0, "refused_lines": 0}
        self._rx, self._tx = slcan.LineDecoder(), slcan.LineDecoder(of_host=True)
        self._joined = False
        self.open_refused: bool = False
        self._pending = deque[str]()  # commands to the adapter itself; a refusal of these is not a lost frame

    def sent(self, data: bytes) -> list[slcan.CanFrame]:
        """Return the frames in text that the host has sent."""
        found = self._tx.feed(data)
        self._pending += found.other_lines
        return found.frames

    def received(self, data: bytes) -> tuple[list[slcan.CanFrame], list[DeviceEvent]]:
        """Return the frames in text from the adapter, and the events about refused frames and damaged lines."""
        found = self._rx.feed_any(data) if self._joined else self._join(data)
        events: list[DeviceEvent] = []
        if found.other_lines or self._pending:
            events += self._answered(found)
        if found.damaged:
            self._losses["damaged_lines"] += found.damaged
            text = f"{number_of(found.damaged, 'damaged line')} dropped"
            events.append(DeviceEvent("damage", self._device, text, {"lines": found.damaged}))
        return found.frames, events

    def _join(self, data: bytes) -> slcan.DecodedLines:
        """Decode the first line of a log, which may be cut at its beginning, without counting damage."""
        end = slcan.first_line_end(data)
        if not end:
            return self._rx.feed(data)
        self._joined = True
        first, found = self._rx.feed(data[:end]), self._rx.feed(data[end:])
        return slcan.DecodedLines(first.frames + found.frames, first.other_lines + found.other_lines, found.damaged)

    def _answered(self, found: slcan.DecodedLines) -> list[DeviceEvent]:
        """Return the event about refused frames in the adapter's answers, which are in the order of the commands."""
        refused = 0
        for line in found.other_lines:
            if line in ("", slcan.BEL):
                refused += line == slcan.BEL and not self._pending
                order = self._pending.popleft() if self._pending else ""
                self.open_refused = line == slcan.BEL if order == "O" else self.open_refused
            elif line in ("z", "Z"):  # a frame was sent: earlier commands to the adapter are not pending any more
                self._pending.clear()
        if found.frames:
            self._pending.clear()  # the bus is open
        if not refused:
            return []
        self._losses["refused_lines"] += refused
        text = (
            f"the adapter refused {number_of(refused, 'line')}: these frames did not go out. Look at the bus "
            f"and its termination"
        )
        return [DeviceEvent("refused", self._device, text, {"lines": refused})]


class FirstContact:
    """Distinction of the start message of a node that was powered before the bus was opened from that of a restart.

    A node sends a message when it starts. Without another node on the bus it is not acknowledged, and the node repeats
    it until the host opens its adapter. The message is then the node's first frame, and the set-up comes after it.

    Attributes:
        pending: whether the bus was opened, and the node has sent nothing else since.
    """

    def __init__(self) -> None:
        self.pending: bool = False

    def sent(self, data: bytes) -> None:
        """Take text that the host has sent to its adapter."""
        self.pending = self.pending or b"O\r" in data

    def heard(self) -> None:
        """Take a frame of the node that is no start message."""
        self.pending = False


class OtherHost:
    """Detection of another node that commands a device: it would keep the device's timeout from expiring.

    An adapter may return sent frames, so a received command that equals one of the last sent ones is not reported. A
    session that only receives sends no command, and reports none.

    Args:
        device: name of the device in the rig file.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._sent: deque[slcan.CanFrame] = deque(maxlen=_KEPT_FRAMES)
        self._reported_ns = -_AGAIN_NS

    @property
    def replaced(self) -> bool:
        """Whether this host commands the device, so that commands on the bus are not its own."""
        return bool(self._sent)

    def sent(self, frame: slcan.CanFrame) -> None:
        """Take a frame that this host has sent to the device."""
        self._sent.append(frame)

    def received(self, frame: slcan.CanFrame, host_ns: int) -> list[DeviceEvent]:
        """Take a command to the device from the bus; return a fault each second if another node sends commands."""
        if not self._sent or frame in self._sent or host_ns - self._reported_ns < _AGAIN_NS:
            return []
        self._reported_ns = host_ns
        text = (
            "another node on the bus commands this device: it would go on turning without its host. Find the node, or "
            "give the device another number"
        )
        return [DeviceEvent("fault", self._device, text, {"identifier": frame.arbitration_id})]


class Adapter:
    """The slcan adapter between a host and the bus.

    Attributes:
        open: whether the host has opened the bus; otherwise no frame is sent to the host.
        repeated: boot-up messages of CANopen nodes without acknowledgement, by identifier. A node repeats its first
            message until another node, here the adapter, is on the bus.
    """

    def __init__(self) -> None:
        self.open: bool = False
        self.repeated: dict[int, slcan.CanFrame] = {}
        self._lines = slcan.LineDecoder(of_host=True)

    def receive(self, data: bytes) -> tuple[list[slcan.CanFrame], bytes]:
        """Take the host's text; return the frames for the bus, and the adapter's own answers."""
        found = self._lines.feed(data)
        answers = slcan.BEL.encode() * found.damaged
        for line in found.other_lines:
            if line[:1] in {"O", "C"}:
                self.open = line[:1] == "O"
            answers += {"V": b"V1013\r", "N": b"N4F1C\r"}.get(line[:1], b"\r")
        for frame in found.frames:
            answers += b"Z\r" if frame.extended else b"z\r"
        return found.frames, answers

    def pass_on(self, frames: Iterable[slcan.CanFrame]) -> bytes:
        """Return the text for the host of frames that nodes send; without an open bus keep boot-up messages."""
        if self.open:
            waiting, self.repeated = self.repeated, {}
            return b"".join(slcan.encode(frame) for frame in (*waiting.values(), *frames))
        boot_ups = (frame for frame in frames if frame.arbitration_id & ~0x7F == _HEARTBEATS and frame.data == _BOOT_UP)
        self.repeated |= {frame.arbitration_id: frame for frame in boot_ups}
        return b""


class BothWays:
    """Filter for a CAN bus, which carries both directions: the host's frames are inserted between the device's lines.

    A read may end in the middle of a line. The incomplete line is held until its end, so that no frame of the host is
    inserted into it; the device's line was not complete before that frame either. Commands of the host to its own
    adapter (open, close, bit rate) are not on the bus and are not played.

    Args:
        omitted: identifiers of the recorded host's frames that only the present host may send.

    Attributes:
        host_is_there: whether a host has replaced the recorded one; then those frames are omitted.
    """

    def __init__(self, omitted: Container[int]) -> None:
        self.host_is_there = False
        self._omitted = omitted
        self._host = slcan.LineDecoder(of_host=True)
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            frames = self._host.feed(data).frames
            omitted = self._omitted if self.host_is_there else ()
            return b"".join(slcan.encode(frame) for frame in frames if frame.arbitration_id not in omitted)
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
