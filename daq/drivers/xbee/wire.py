# pyright: strict
"""What XBee API frames hold: frame data to frames, requests to frame data; `framing` brings them over the line.

Frame data begin with their type. Numbers are big endian, unlike those of the RotorLink payloads inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

UNKNOWN_16 = 0xFFFE

DELIVERED = 0
DELIVERY = {
    0x00: "delivered",
    0x01: "no acknowledgement from the node's module: out of reach, or without power",
    0x02: "the channel was never free",
    0x03: "purged before it was sent",
    0x15: "invalid destination endpoint",
    0x18: "no buffers in the module",
    0x21: "no acknowledgement over the network: the node's module is out of reach, or without power",
    0x22: "the module has not joined a network",
    0x23: "node_address is the module's own",
    0x24: "no module of this address in the network",
    0x25: "no route to the node's module",
    0x31: "internal error of the module",
    0x32: "no free buffers or timers in the module",
    0x74: "payload too large",
    0x75: "not fetched by a sleeping module",
    0xBB: "key not authorized",
}
"""Words for the status of a transmit request, those of the makers' lists that a node's command can meet."""
MODEM = {
    0x00: "hardware reset or power-up",
    0x01: "watchdog reset",
    0x02: "joined a network",
    0x03: "left its network",
    0x04: "configuration error, or synchronization lost",
    0x05: "coordinator realignment",
    0x06: "started a network",
    0x07: "network key updated",
    0x0B: "network woke up",
    0x0C: "network went to sleep",
    0x0D: "supply voltage beyond its limit",
    0x11: "configuration changed while joining",
}
"""Words for a module's status of itself."""
RESTARTS = frozenset((0x00, 0x01))
AT_STATUS = ("ok", "error", "invalid command", "invalid parameter", "transmission failed")


@dataclass(frozen=True)
class Address:
    """Of a module: 64 bits, or 16 in a network that uses them."""

    value: int
    bits: Literal[16, 64]

    @classmethod
    def parse(cls, text: str) -> Address:
        """From 16 or 4 hex digits.

        Raises:
            ValueError: neither.
        """
        if len(text) not in (4, 16):
            raise ValueError(f"expected an address of 16 or 4 hex digits, got {text!r}")
        return cls(int(text, 16), 64 if len(text) == 16 else 16)

    def __str__(self) -> str:
        """Its hex digits."""
        return f"{self.value:0{self.bits // 4}X}"


# --- frames from the module ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Received:
    """Radio data (types 90h, 91h, 80h, 81h).

    Attributes:
        source_64, source_16: the sender's addresses; None where the frame gives none, or one that says "unknown".
        rssi_dBm: signal strength; None where the frame does not give it.
        options: as sent.
        payload: the radio data.
    """

    source_64: int | None
    source_16: int | None
    rssi_dBm: int | None
    options: int
    payload: bytes

    def comes_from(self, address: Address) -> bool:
        """Whether that module sent it."""
        return address.value == (self.source_64 if address.bits == 64 else self.source_16)

    @property
    def source(self) -> str:
        """The sender, for a message."""
        if self.source_64 is not None:
            return str(Address(self.source_64, 64))
        return "unknown" if self.source_16 is None else str(Address(self.source_16, 16))


@dataclass(frozen=True)
class TransmitStatus:
    """What became of a transmit request (types 8Bh, 89h); status is one of `DELIVERY`."""

    frame_id: int
    status: int

    @property
    def words(self) -> str:
        """The status in words."""
        return f"{DELIVERY.get(self.status, 'not delivered')} (status 0x{self.status:02X})"


@dataclass(frozen=True)
class ModemStatus:
    """Something happened to the module itself (type 8Ah); status is one of `MODEM`."""

    status: int

    @property
    def words(self) -> str:
        """The status in words."""
        return f"{MODEM.get(self.status, 'modem status')} (0x{self.status:02X})"


@dataclass(frozen=True)
class AtAnswer:
    """Answer to a local AT command (type 88h); status indexes `AT_STATUS`."""

    frame_id: int
    command: str
    status: int
    value: bytes


@dataclass(frozen=True)
class Other:
    """A sound frame of a type that nobody here asked for."""

    frame_type: int


ApiFrame = Received | TransmitStatus | ModemStatus | AtAnswer | Other

_PARTS: dict[int, tuple[int, bool, Callable[[bytes], ApiFrame]]] = {
    0x90: (12, False, lambda d: Received(_known_64(d[1:9]), _known_16(d[9:11]), None, d[11], d[12:])),
    0x91: (18, False, lambda d: Received(_known_64(d[1:9]), _known_16(d[9:11]), None, d[17], d[18:])),
    0x80: (11, False, lambda d: Received(_known_64(d[1:9]), None, -d[9], d[10], d[11:])),
    0x81: (5, False, lambda d: Received(None, _known_16(d[1:3]), -d[3], d[4], d[5:])),
    0x8B: (7, True, lambda d: TransmitStatus(d[1], d[5])),
    0x89: (3, True, lambda d: TransmitStatus(d[1], d[2])),
    0x8A: (2, True, lambda d: ModemStatus(d[1])),
    0x88: (5, False, lambda d: AtAnswer(d[1], d[2:4].decode("latin-1"), d[4], d[5:])),
}
"""By type: bytes before the variable part, whether there is none, and what makes the frame."""


def parse(data: bytes) -> ApiFrame:
    """Frame of its data: what stands between length and checksum, without escapes.

    Args:
        data: at least one byte.

    Raises:
        ValueError: too short or too long for its type.
    """
    if data[0] not in _PARTS:
        return Other(data[0])
    size, fixed, make = _PARTS[data[0]]
    if len(data) < size or (fixed and len(data) > size):
        raise ValueError(f"expected {size} bytes of type {data[0]:#04x}{'' if fixed else ' or more'}, got {len(data)}")
    return make(data)


def _known_64(data: bytes) -> int | None:
    value = int.from_bytes(data, "big")
    return None if value == 0xFFFF_FFFF_FFFF_FFFF else value


def _known_16(data: bytes) -> int | None:
    value = int.from_bytes(data, "big")
    return None if value >= UNKNOWN_16 else value


# --- frames to the module --------------------------------------------------------------------------------------


def at_command(frame_id: int, command: str, value: bytes = b"") -> bytes:
    """Frame data of a local AT command (type 08h)."""
    return bytes((0x08, frame_id)) + command.encode("ascii") + value


def transmit_request(frame_id: int, address: Address, payload: bytes, *, legacy: bool = False) -> bytes:
    """Frame data of radio data to a node, with acknowledgement.

    Args:
        frame_id: 1 … 255; comes back in the `TransmitStatus`.
        legacy: types 00h and 01h rather than 10h.
    """
    to = address.value.to_bytes(address.bits // 8, "big")
    if legacy:
        return bytes((0x00 if address.bits == 64 else 0x01, frame_id)) + to + b"\x00" + payload
    both = to + UNKNOWN_16.to_bytes(2, "big") if address.bits == 64 else b"\xff" * 8 + to
    return bytes((0x10, frame_id)) + both + b"\x00\x00" + payload
