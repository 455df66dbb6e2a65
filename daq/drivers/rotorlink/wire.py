"""RotorLink v1: the encoder node on the rotor, its radio dongle, and the commands to it.

On a serial line a frame is ``COBS(payload) 0x00``; on an XBee the payload is the radio data. The payload is a body and
its CRC-16/CCITT-FALSE (polynomial 1021h, start FFFFh, low byte first; "123456789" gives 29B1h), at most 250 bytes on
air. All numbers are little endian. Each body starts with type u8, node u8 and seq u16. The seq counts the sender's
frames of all types and wraps: a gap in it means lost frames, a repeated frame is dropped. Bytes that are not an intact
frame are counted and skipped, up to the next 0x00. Node time is µs since the node's start (u32, wraps after 71.6 min).
After a restart time, index and seq start at 0.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from daq.drivers.rotorlink import byte_stuffing
from rig_basics.texts import number_of

COUNTS_DTYPE = np.dtype("<i4")
MAX_SAMPLES = 29
MAX_PAYLOAD_BYTES = 250
MAX_WRAPPED_BYTES = MAX_PAYLOAD_BYTES + 11  # a dongle's wrapper is sent over the cable only, never on air
NO_COMMAND = 0xFFFF

FLAG_FAULT_A, FLAG_FAULT_B, FLAG_SAMPLES_LOST, FLAG_LOW_BATTERY = 1 << 0, 1 << 1, 1 << 2, 1 << 3
FLAG_REPEATS, FLAG_LOCK_A_CLOSED, FLAG_LOCK_B_CLOSED = 1 << 4, 1 << 5, 1 << 6

LOCK_STATES = ("locked", "released", "moving", "fault")
ACTIONS = {"lock A": 1, "lock B": 2, "lock both": 3, "release A": 4, "release both": 5, "release B": 6, "zero": 7}
RESULTS = (
    "accepted",
    "refused: rotor turning",
    "unknown command",
    "fault",
    "refused: not locked, or already so",
)


class BadFrame(ValueError):
    """A payload is not a frame; `reason` is ``crc``, ``type`` or ``length``.

    Attributes:
        skipped: type, node and seq of the payload if its CRC is correct.
    """

    def __init__(self, reason: str, text: str, skipped: Skipped | None = None) -> None:
        super().__init__(text)
        self.reason: str = reason
        self.skipped: Skipped | None = skipped


@dataclass(frozen=True)
class Skipped:
    """A frame with a correct CRC and an unknown type or length. Its sender has counted it."""

    kind: int
    node: int
    seq: int

    DONGLES: ClassVar[range] = range(0x20, 0x30)
    NODES: ClassVar[range] = range(0x10, 0x20)


def crc16(body: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 0x29B1 for ``b"123456789"``."""
    return binascii.crc_hqx(body, 0xFFFF)


def encode_frame(body: bytes) -> bytes:
    """Return the payload of a body: the body and its CRC, low byte first."""
    return body + crc16(body).to_bytes(2, "little")


def wire(payload: bytes) -> bytes:
    """Encode a payload for a serial line: COBS, then 0x00."""
    return byte_stuffing.encode(payload) + b"\x00"


class _Packed:
    """A frame of constant size: its fields in order, packed as `LAYOUT` after the type."""

    TYPE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        """Return the payload: body and CRC.

        Raises:
            struct.error: a field does not fit its integer on the wire.
        """
        return encode_frame(self.LAYOUT.pack(self.TYPE, *vars(self).values()))


@dataclass(frozen=True, eq=False)
class EncoderBlock:
    """Encoder samples of both pendulums, evenly spaced in node time.

    Attributes:
        node: number of the node.
        seq: number of the frame, wraps at 2**16.
        first_index: index of the first sample since the node's start, wraps at 2**32.
        node_time_us: node time of the first sample, µs, wraps at 2**32.
        period_us: time between samples, µs.
        flags: `FLAG_…` bits.
        counts: int32 of shape (n, 2), columns A and B, n = 1 … 29; positive with the rotation, relative to the rotor.
    """

    TYPE: ClassVar[int] = 0x11
    HEAD: ClassVar[struct.Struct] = struct.Struct("<BBHIIHBB")

    node: int
    seq: int
    first_index: int
    node_time_us: int
    period_us: int
    flags: int
    counts: NDArray[np.int32] = field(repr=False)

    def pack(self) -> bytes:
        """Return the payload: body and CRC.

        Raises:
            ValueError: the shape of counts is not (1 … 29, 2).
        """
        counts = np.asarray(self.counts, COUNTS_DTYPE)
        if counts.ndim != 2 or counts.shape[1] != 2 or not 1 <= len(counts) <= MAX_SAMPLES:
            raise ValueError(f"expected counts of shape (1 … {MAX_SAMPLES}, 2), got {counts.shape}")
        head = (self.node, self.seq, self.first_index, self.node_time_us, self.period_us, len(counts), self.flags)
        return encode_frame(self.HEAD.pack(self.TYPE, *head) + counts.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EncoderBlock) and self.pack() == other.pack()

    def __hash__(self) -> int:
        return hash((self.node, self.seq, self.first_index))


@dataclass(frozen=True)
class NodeStatus(_Packed):
    """The node's state, sent each second; temperature in 0.1 °C, battery in mV."""

    TYPE: ClassVar[int] = 0x12
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHIHhIHBBI")

    node: int
    seq: int
    node_time_us: int
    battery_mv: int
    temperature_decidegc: int
    frames_sent: int
    overruns: int
    firmware_major: int
    firmware_minor: int
    counts_per_revolution: int


@dataclass(frozen=True)
class LockEvent(_Packed):
    """Change of a pendulum's lock.

    `pendulum` is 0 for A and 1 for B. `state` indexes `LOCK_STATES`. `command_seq` is `NO_COMMAND` without a command.
    """

    TYPE: ClassVar[int] = 0x13
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHIBBH")

    node: int
    seq: int
    node_time_us: int
    pendulum: int
    state: int
    command_seq: int


@dataclass(frozen=True)
class Pong(_Packed):
    """Answer to a ping, with the node times at which the ping was received and this answer was sent."""

    TYPE: ClassVar[int] = 0x14
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHIIH")

    node: int
    seq: int
    received_us: int
    answered_us: int
    ping_seq: int


@dataclass(frozen=True)
class IndexMark(_Packed):
    """Passage of the rotor's index at the mark on the frame: the tachometer and phase reference."""

    TYPE: ClassVar[int] = 0x15
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHII")

    node: int
    seq: int
    node_time_us: int
    revolutions: int


@dataclass(frozen=True)
class Acknowledge(_Packed):
    """Answer to a command; `result` indexes `RESULTS`."""

    TYPE: ClassVar[int] = 0x16
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHHB")

    node: int
    seq: int
    command_seq: int
    result: int


@dataclass(frozen=True)
class DongleStatus(_Packed):
    """The dongle's state, sent each second: frames received, frames damaged on air, signal strength in dBm."""

    TYPE: ClassVar[int] = 0x20
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHIIIb")

    node: int
    seq: int
    dongle_time_us: int
    frames_received: int
    frames_damaged: int
    rssi_dbm: int


@dataclass(frozen=True)
class NodeCommand(_Packed):
    """Host to node: one of `ACTIONS`. Without an answer it is repeated with the same seq; the node acts once."""

    TYPE: ClassVar[int] = 0x90
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBHBx")

    node: int
    seq: int
    action: int


@dataclass(frozen=True)
class Ping(_Packed):
    """Host to node: request for the node's time; answered by `Pong`."""

    TYPE: ClassVar[int] = 0x91
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BBH")

    node: int
    seq: int


NodeFrame = EncoderBlock | NodeStatus | LockEvent | Pong | IndexMark | Acknowledge


@dataclass(frozen=True)
class Wrapped:
    """A node's frame as a dongle received it. Its own seq counts losses on the cable, the inner seq those on air.

    Attributes:
        dongle_time_us: dongle time at reception, µs, wraps at 2**32.
        rssi_dbm: signal strength of this frame, dBm.
        inner: the node's frame, None if it is damaged; a `Skipped` frame is in `damaged` too.
        damaged: the inner payload as received if it is not a frame, otherwise empty.
        damage: reason as in `BadFrame.reason`; empty without damage.
    """

    TYPE: ClassVar[int] = 0x21
    HEAD: ClassVar[struct.Struct] = struct.Struct("<BBHIb")

    node: int
    seq: int
    dongle_time_us: int
    rssi_dbm: int
    inner: NodeFrame | Skipped | None
    damaged: bytes = b""
    damage: str = ""

    def pack(self) -> bytes:
        """Return the payload: body and CRC."""
        inner = self.damaged if self.inner is None or isinstance(self.inner, Skipped) else self.inner.pack()
        head = self.HEAD.pack(self.TYPE, self.node, self.seq, self.dongle_time_us, self.rssi_dbm)
        return encode_frame(head + inner)


Frame = NodeFrame | DongleStatus | Wrapped | NodeCommand | Ping | Skipped
_NODE_CLASSES: dict[int, Any] = {kind.TYPE: kind for kind in (NodeStatus, LockEvent, Pong, IndexMark, Acknowledge)}
_ALL_CLASSES = _NODE_CLASSES | {kind.TYPE: kind for kind in (DongleStatus, NodeCommand, Ping)}


def _checked_body(payload: bytes, limit: int) -> bytes:
    if not 6 <= len(payload) <= limit:
        raise BadFrame("length", f"expected a payload of 6 … {number_of(limit, 'byte')}, got {len(payload)}")
    body = payload[:-2]
    expected, came = int.from_bytes(payload[-2:], "little"), crc16(body)
    if expected != came:
        raise BadFrame("crc", f"expected CRC {expected:#06x} as in the frame, its bytes give {came:#06x}")
    return body


def _skipped(body: bytes) -> Skipped:
    return Skipped(body[0], body[1], int.from_bytes(body[2:4], "little"))


def _parse_body(body: bytes, layouts: dict[int, Any]) -> Any:
    """Return the frame of a constant-size body, by its type."""
    kind = layouts.get(body[0])
    if kind is None:
        raise BadFrame("type", f"expected a type of {sorted(map(hex, layouts))}, got {body[0]:#04x}", _skipped(body))
    if len(body) != kind.LAYOUT.size:
        text = f"expected {number_of(kind.LAYOUT.size, 'byte')} for {kind.__name__}, got {len(body)}"
        raise BadFrame("length", text, _skipped(body))
    return kind(*kind.LAYOUT.unpack(body)[1:])


def _parse_encoder(body: bytes) -> EncoderBlock:
    head = EncoderBlock.HEAD
    samples = body[head.size - 2] if len(body) >= head.size else 0
    if not 1 <= samples <= MAX_SAMPLES or len(body) != head.size + 8 * samples:
        text = f"expected 1 … {MAX_SAMPLES} samples of 8 bytes, got {samples} in {number_of(len(body), 'byte')}"
        raise BadFrame("length", text, _skipped(body))
    _, node, seq, first_index, node_time_us, period_us, _, flags = head.unpack_from(body)
    counts = np.frombuffer(body, COUNTS_DTYPE, offset=head.size).reshape(samples, 2)
    return EncoderBlock(node, seq, first_index, node_time_us, period_us, flags, counts)


def parse_node(payload: bytes) -> NodeFrame:
    """Parse a node's own payload, bare or from a dongle's wrapper.

    Raises:
        BadFrame: the CRC is wrong, the type is unknown or the length is wrong.
    """
    body = _checked_body(payload, MAX_PAYLOAD_BYTES)
    return _parse_encoder(body) if body[0] == EncoderBlock.TYPE else _parse_body(body, _NODE_CLASSES)


def parse(payload: bytes) -> Frame:
    """Parse any payload, from the node, the dongle or the host.

    An intact wrapper around a damaged inner payload is returned with ``inner=None`` and the bytes in `damaged`.

    Raises:
        BadFrame: the CRC is wrong, the type is unknown or the length is wrong.
    """
    if payload[:1] != bytes([Wrapped.TYPE]):
        body = _checked_body(payload, MAX_PAYLOAD_BYTES)
        return _parse_encoder(body) if body[0] == EncoderBlock.TYPE else _parse_body(body, _ALL_CLASSES)
    body = _checked_body(payload, MAX_WRAPPED_BYTES)
    if len(body) < Wrapped.HEAD.size:
        raise BadFrame(
            "length", f"expected at least {number_of(Wrapped.HEAD.size, 'byte')} for Wrapped, got {len(body)}"
        )
    head, tail = Wrapped.HEAD.unpack_from(body)[1:], body[Wrapped.HEAD.size :]
    try:
        return Wrapped(*head, inner=parse_node(tail))
    except BadFrame as fault:
        own = fault.skipped is not None and fault.skipped.kind in Skipped.NODES
        return Wrapped(*head, inner=fault.skipped if own else None, damaged=tail, damage=fault.reason)
