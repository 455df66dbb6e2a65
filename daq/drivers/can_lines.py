"""Parts that drivers of devices on a CAN bus have in common, for host and far end.

`CanLines` decodes the records of a link (`daq.transports.can_frames`) in pipelines. `Adapter` is a far end's access to
the bus in simulated devices and in stand-ins for playing, `BothWays` the filter of the latter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Iterable
from typing import Any

from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.contract import Talk
from daq.drivers.played import BytesFromDevice, PlayedDevice
from daq.drivers.sparing import EachSecond
from daq.items import RX, TX, DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, AdapterMessage, CanFrame, Decoded, FrameDecoder, encode, opens_bus
from rig_basics.texts import number_of

_KEPT_FRAMES = 64  # sent frames with which a received command is compared
_HEARTBEATS, _BOOT_UP = 0x700, b"\x00"  # identifiers of CANopen heartbeats, and the first one of a node


def close_bus(settings: Any, talk: Talk) -> None:
    """Close the bus at the adapter: the device is stopped, or is silent without the host's requests."""
    talk.send(CLOSE_BUS)


class CanLines:
    """Decoder of a link's records in both directions.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline; this decoder adds and counts `damaged_lines` and `refused_lines`.

    Attributes:
        open_refused: whether the adapter has refused the last command to open the bus that it has answered.
    """

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        self._device, self._losses = device, losses
        losses |= {"damaged_lines": 0, "refused_lines": 0}
        self._rx, self._tx = FrameDecoder(), FrameDecoder()
        self.open_refused: bool = False

    def sent(self, data: bytes) -> list[CanFrame]:
        """Return the frames in records of the host."""
        return self._tx.feed(data).frames

    def received(self, data: bytes) -> tuple[list[CanFrame], list[DeviceEvent]]:
        """Return the frames in received records, and the events about refused frames and damaged lines."""
        found = self._rx.feed(data)
        return found.frames, self._events(found)

    def received_rows(self, data: bytes) -> tuple[NDArray[Any], list[DeviceEvent]]:
        """Return `received` with the frames as rows of `Decoded`."""
        found = self._rx.feed(data)
        return found.rows[found.is_of_bus], self._events(found)

    def _events(self, found: Decoded) -> list[DeviceEvent]:
        damaged, refused = found.damaged, 0
        for kind, number in found.of_adapter:
            damaged += number if kind is AdapterMessage.DAMAGED else 0
            refused += number if kind is AdapterMessage.REFUSED else 0
            if kind in (AdapterMessage.OPENED, AdapterMessage.OPEN_REFUSED):
                self.open_refused = kind is AdapterMessage.OPEN_REFUSED
        events: list[DeviceEvent] = []
        if refused:
            self._losses["refused_lines"] += refused
            text = (
                f"the adapter refused {number_of(refused, 'line')}: these frames did not go out. Look at the bus "
                f"and its termination"
            )
            events.append(DeviceEvent("refused", self._device, text, {"lines": refused}))
        if damaged:
            self._losses["damaged_lines"] += damaged
            text = f"{number_of(damaged, 'damaged line')} dropped"
            events.append(DeviceEvent("damage", self._device, text, {"lines": damaged}))
        return events


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
        """Take records of the host."""
        self.pending = self.pending or opens_bus(data)

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
        self._sent: deque[CanFrame] = deque(maxlen=_KEPT_FRAMES)
        self._each_second = EachSecond()

    @property
    def replaced(self) -> bool:
        """Whether this host commands the device, so that commands on the bus are not its own."""
        return bool(self._sent)

    def sent(self, frame: CanFrame) -> None:
        """Take a frame that this host has sent to the device."""
        self._sent.append(frame)

    def received(self, frame: CanFrame, host_ns: int) -> list[DeviceEvent]:
        """Take a command to the device from the bus; return a fault each second if another node sends commands."""
        if not self._sent or frame in self._sent or not self._each_second.passes(host_ns):
            return []
        text = (
            "another node on the bus commands this device: it would go on turning without its host. Find the node, or "
            "give the device another number"
        )
        return [DeviceEvent("fault", self._device, text, {"identifier": frame.arbitration_id})]


class Adapter:
    """A far end's access to the bus.

    Attributes:
        open: whether the host has opened the bus; otherwise no frame is sent to the host.
        repeated: boot-up messages of CANopen nodes without acknowledgement, by identifier. A node repeats its first
            message until another node, here the adapter, is on the bus.
        out: frames of nodes, which wait to be passed on.
    """

    def __init__(self) -> None:
        self.open: bool = False
        self.out: list[CanFrame] = []
        self.repeated: dict[int, CanFrame] = {}
        self._records = FrameDecoder()

    def receive(self, data: bytes) -> list[CanFrame]:
        """Take records of the host; return the frames for the bus."""
        found = self._records.feed(data)
        for kind, _ in found.of_adapter:
            if kind in (AdapterMessage.OPEN, AdapterMessage.CLOSE):
                self.open = kind is AdapterMessage.OPEN
        return found.frames

    def pass_on(self) -> bytes:
        """Return the records for the host of the waiting frames; without an open bus keep boot-up messages only."""
        frames, self.out = self.out, []
        if self.open:
            waiting, self.repeated = self.repeated, {}
            return encode(*waiting.values(), *frames)
        boot_ups = (frame for frame in frames if frame.arbitration_id & ~0x7F == _HEARTBEATS and frame.data == _BOOT_UP)
        self.repeated |= {frame.arbitration_id: frame for frame in boot_ups}
        return b""


class BothWays(BytesFromDevice):
    """Filter for a CAN bus, which carries both directions: the host's frames are inserted between the device's.

    Messages between the host and its own adapter (open, close, refusals) are not on the bus and are not played.

    Args:
        omitted: identifiers of the recorded host's frames that only the present host may send.

    Attributes:
        host_is_there: whether a host has replaced the recorded one; then those frames are omitted.
    """

    def __init__(self, omitted: Container[int]) -> None:
        self.host_is_there = False
        self._omitted = omitted
        self._decoders = {RX: FrameDecoder(), TX: FrameDecoder()}

    @override
    def feed(self, direction: int, data: bytes) -> bytes:
        omitted = self._omitted if self.host_is_there and direction != RX else ()
        return encode(
            *(frame for frame in self._decoders[direction].feed(data).frames if frame.arbitration_id not in omitted)
        )

    @override
    def remainder(self) -> bytes:
        return b""


class PlayedOnBus(PlayedDevice):
    """Stand-in for devices of a log on a bus. It sends while the host has the bus open.

    Args:
        omitted: see BothWays.
    """

    def __init__(self, omitted: Container[int]) -> None:
        self.bus: BothWays = BothWays(omitted)
        super().__init__(self.bus)
        self.adapter: Adapter = Adapter()

    @property
    @override
    def sending(self) -> bool:
        return self.adapter.open

    @override
    def begin(self) -> None:
        self.adapter.open = True

    @override
    def hear(self, data: bytes) -> bytes:
        was_open = self.adapter.open
        frames = self.adapter.receive(data)
        self.commands += sum(map(self.is_command, frames))
        self.bus.host_is_there |= any(map(self.is_host, frames))
        first = self.first_frames() if self.adapter.open and not was_open else ()
        answers = [answer for frame in frames for answer in self.answers(frame)]
        return encode(*first, *answers) if self.adapter.open else b""

    def is_command(self, frame: CanFrame) -> bool:
        """Whether a frame counts as a command to the devices."""
        return True

    def is_host(self, frame: CanFrame) -> bool:
        """Whether a frame shows that a host replaces the recorded one."""
        return True

    def first_frames(self) -> Iterable[CanFrame]:
        """Return the frames to send when the bus is opened."""
        return ()

    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        """Return the answers to a frame of the host."""
        return ()
