"""Content of XBee API frames: parsing of frame data, and frame data of requests; `framing` encodes them for the line.

Frame data begin with the type of the frame. Numbers are big endian, unlike those of the RotorLink payloads inside.
From the module:

- 90h receive packet: source address u64, source network address u16 (FFFEh unknown), options u8, radio data
- 91h explicit receive: as 90h, but source and destination endpoint u8 u8, cluster u16, profile u16 before the options
- 80h, 81h receive packet: source address u64 or u16, strength u8 (−dBm), options u8, radio data
- 8Bh transmit status: frame id u8, network address u16, retries u8, status u8, discovery u8
- 89h transmit status: frame id u8, status u8
- 8Ah modem status: status u8 (00h power-up or reset, 01h watchdog, …)
- 88h AT answer: frame id u8, command 2 letters, status u8 (0 ok), value

From the host:

- 08h AT command: frame id u8, command 2 letters
- 10h transmit request: frame id u8, destination u64, network address u16, radius u8 = 0, options u8 = 0, radio data. To
  a 16-bit address the destination is FFFFFFFFFFFFFFFFh, to a 64-bit address the network address is FFFEh.
- 00h, 01h transmit request: frame id u8, destination u64 or u16, options u8 = 0, radio data
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from rig_basics.texts import number_of

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
"""Texts for the status of a transmit request: those in the manufacturers' lists that are possible for a command."""
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
"""Texts for the status that a module reports of itself."""
RESTARTS = frozenset((0x00, 0x01))
AT_STATUS = ("ok", "error", "invalid command", "invalid parameter", "transmission failed")
_OTHER_STATUS = "status "


@dataclass(frozen=True)
class Address:
    """Address of a module: 64 bits, or 16 bits in a network with such addresses."""

    value: int
    bits: Literal[16, 64]

    @classmethod
    def parse(cls, text: str) -> Address:
        """Parse 16 or 4 hex digits.

        Raises:
            ValueError: the text has another form.
        """
        if len(text) not in (4, 16):
            raise ValueError(f"expected an address of 16 or 4 hex digits, got {text!r}")
        return cls(int(text, 16), 64 if len(text) == 16 else 16)

    def __str__(self) -> str:
        """Return the address as hex digits."""
        return f"{self.value:0{self.bits // 4}X}"


# --- frames from the module ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Received:
    """Radio data (types 90h, 91h, 80h, 81h).

    Attributes:
        source_64, source_16: the sender's addresses; None if the frame does not contain it, or contains "unknown".
        rssi_dBm: signal strength, dBm; None if the frame does not contain it.
        options: option bits as received.
        payload: the radio data.
    """

    source_64: int | None
    source_16: int | None
    rssi_dBm: int | None
    options: int
    payload: bytes

    def comes_from(self, address: Address) -> bool:
        """Whether the module of this address has sent the frame."""
        return address.value == (self.source_64 if address.bits == 64 else self.source_16)

    @property
    def source(self) -> str:
        """Address of the sender for a message."""
        if self.source_64 is not None:
            return str(Address(self.source_64, 64))
        return "unknown" if self.source_16 is None else str(Address(self.source_16, 16))


@dataclass(frozen=True)
class TransmitStatus:
    """Result of a transmit request (types 8Bh, 89h); `status` is a key of `DELIVERY`."""

    frame_id: int
    status: int

    @property
    def words(self) -> str:
        """Text for the status."""
        return f"{DELIVERY.get(self.status, 'not delivered')} (status 0x{self.status:02X})"


@dataclass(frozen=True)
class ModemStatus:
    """Report of the module about itself (type 8Ah); `status` is a key of `MODEM`."""

    status: int

    @property
    def words(self) -> str:
        """Text for the status."""
        return f"{MODEM.get(self.status, 'modem status')} (0x{self.status:02X})"


@dataclass(frozen=True)
class AtAnswer:
    """Answer to a local AT command (type 88h); `status` indexes `AT_STATUS`."""

    frame_id: int
    command: str
    status: int
    value: bytes

    @property
    def text(self) -> str:
        """Text of the answer in the log and in the replies of a dialogue; see `of_text`."""
        status = AT_STATUS[self.status] if self.status < len(AT_STATUS) else f"{_OTHER_STATUS}{self.status}"
        return f"{self.frame_id} {self.command} {self.value.hex()} {status}"

    @classmethod
    def of_text(cls, text: str) -> AtAnswer:
        """Return the answer of a text.

        Raises:
            ValueError: the text is not that of an answer.
        """
        frame_id, _, tail = text.partition(" ")
        command = tail[:2]  # two characters, which a foreign module may send as spaces
        value, _, status = tail[3:].partition(" ")
        number = AT_STATUS.index(status) if status in AT_STATUS else int(status.removeprefix(_OTHER_STATUS))
        return cls(int(frame_id), command, number, bytes.fromhex(value))


@dataclass(frozen=True)
class UnusedFrame:
    """An intact frame of a type that this software does not use."""

    frame_type: int


ApiFrame = Received | TransmitStatus | ModemStatus | AtAnswer | UnusedFrame

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
"""By type: number of bytes before the variable part, whether the size is fixed, constructor of the frame."""


def parse(data: bytes) -> ApiFrame:
    """Parse frame data: the bytes between length and checksum, without escapes.

    Args:
        data: at least one byte.

    Raises:
        ValueError: the data are too short or too long for their type.
    """
    if data[0] not in _PARTS:
        return UnusedFrame(data[0])
    size, fixed, make = _PARTS[data[0]]
    if len(data) < size or (fixed and len(data) > size):
        raise ValueError(
            f"expected {number_of(size, 'byte')} of type {data[0]:#04x}{'' if fixed else ' or more'}, got {len(data)}"
        )
    return make(data)


def _known_64(data: bytes) -> int | None:
    value = int.from_bytes(data, "big")
    return None if value == 0xFFFF_FFFF_FFFF_FFFF else value


def _known_16(data: bytes) -> int | None:
    value = int.from_bytes(data, "big")
    return None if value >= UNKNOWN_16 else value


def module_identity(values: Mapping[str, bytes | None]) -> dict[str, str]:
    """Return firmware, hardware (hex) and serial (16 hex digits) of a module, those that it has answered.

    Args:
        values: values of the AT commands VR, HV, SH and SL; empty or None without an answer.
    """
    high, low = values["SH"], values["SL"]
    serial = high.rjust(4, b"\0") + low.rjust(4, b"\0") if high and low else None
    parts = {"firmware": values["VR"], "hardware": values["HV"], "serial": serial}
    return {name: value.hex().upper() for name, value in parts.items() if value}


# --- frames to the module --------------------------------------------------------------------------------------


def at_command(frame_id: int, command: str, value: bytes = b"") -> bytes:
    """Return the frame data of a local AT command (type 08h)."""
    return bytes((0x08, frame_id)) + command.encode("ascii") + value


def transmit_request(frame_id: int, address: Address, payload: bytes, *, legacy: bool = False) -> bytes:
    """Return the frame data of a request to send radio data to a node, with acknowledgement.

    Args:
        frame_id: 1 … 255; the `TransmitStatus` contains it.
        address: address of the node's module.
        payload: the radio data.
        legacy: whether types 00h and 01h are used in place of 10h.
    """
    to = address.value.to_bytes(address.bits // 8, "big")
    if legacy:
        return bytes((0x00 if address.bits == 64 else 0x01, frame_id)) + to + b"\x00" + payload
    both = to + UNKNOWN_16.to_bytes(2, "big") if address.bits == 64 else b"\xff" * 8 + to
    return bytes((0x10, frame_id)) + both + b"\x00\x00" + payload
