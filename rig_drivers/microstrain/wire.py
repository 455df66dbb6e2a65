"""Packets of a MicroStrain base station: frames with their check, requests, and the sweeps of synchronized sampling.

Version 1: ``AA``, delivery flags u8, type u8, address u16, length u8, payload, RSSI of the node i8, RSSI of the base
station i8, sum u16. The sum is that of the bytes from the flags to the end of the payload. Version 3: ``AC``, flags u8,
type u8, address u32, length u16, payload, RSSI i8 i8, CRC-32 of all bytes before it. Numbers are big endian. Requests
of version 1 have no RSSI bytes; those of version 3 have ``7F 7F``. Delivery flags of requests to base station and
node: 0Eh and 05h (version 1), 01h and 04h (version 3). With version 1 the base station sends a single ``AA`` after a
request to a node, which is not damage.

Sweeps, type 1Ah. Version 1: channel mask u16, rate code u8, mode and data type (4 bits each), tick u16, s u32, ns u32,
values of one sweep after the other. Version 3: four unused bytes, mask u16, rate code u8, data type u8, tick u16, ns
since 1970 u64, values. Tick and time are those of the first sweep.

- Data types: 1 u16 without its lowest bit, 2 f32 calibrated by the node, 3 and 7 u16, 4 u32, 8 f32, 9 and 13 u24,
  10 u16 · 4, 11 i24, 12 i16 · 64, 14 u16 · 256, 15 i16 / 10.
- Rate codes: 113 − n for 2ⁿ Hz, 61 + n for n kHz up to 10, 46 for 300, 47 for 800, 48 for 1600, 49 for 3200, 98 for
  887 Hz.
- Older nodes, 8 channels: type 0Ah (version 1 only): mode u8, channel mask u8, rate code u8, data type u8, then as
  above from the tick. Some use type 09h, otherwise low duty cycle; mode 2 distinguishes them.

Source: the maker's open library (LORD-MicroStrain/MSCL). Unverified: the coding of RSSI in version 3.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of
from rig_drivers.microstrain.rates import BASE_ADDRESS

Version = Literal[1, 3]


class Layout(NamedTuple):
    """Layout of the packets of a version.

    Attributes:
        start: first byte.
        head, tail: bytes before and after the payload.
        sweep_head: bytes of a payload with sweeps before the first sweep.
    """

    start: int
    head: int
    tail: int
    sweep_head: int


LAYOUTS: dict[Version, Layout] = {1: Layout(0xAA, 6, 4, 14), 3: Layout(0xAC, 9, 6, 18)}
MAX_PAYLOAD = 255
"""Longest accepted payload, bytes: the limit of version 1; radio packets of nodes are shorter."""

# types of packets
NODE_COMMAND, NODE_ERROR, NODE_SUCCESS = 0x00, 0x02, 0x22
BASE_COMMAND, BASE_SUCCESS, BASE_ERROR, BASE_RECEIVED = 0x30, 0x31, 0x32, 0x34
SYNC_SAMPLES, SYNC_SAMPLES_8 = 0x1A, 0x0A
"""Synchronized sampling of nodes with 16 channels, and of older nodes with 8 channels."""
_MISNAMED_8 = 0x09  # type of a packet SYNC_SAMPLES_8 of the oldest nodes, if its mode is continuous
OTHER_SAMPLES = {
    0x04: "low duty cycle",
    0x09: "low duty cycle",
    0x0D: "buffered low duty cycle",
    0x0E: "digital events",
    0x0F: "digital events",
    0x14: "low duty cycle",
    0x15: "derived values",
    0x1B: "derived values",
    0x1D: "buffered low duty cycle",
    0xA0: "structural health",
}
"""Types of packets with samples of other kinds, and their names."""
BEACON_ECHO = 0x10
"""Repetition of the beacon, which a base station sends if it is set up for it."""
REPLIES = frozenset((NODE_COMMAND, NODE_ERROR, 0x20, NODE_SUCCESS, BASE_SUCCESS, BASE_ERROR, BASE_RECEIVED))
DISCOVERIES = frozenset((0x07, 0x16, 0x17, 0x18))
"""Types of the packets by which a node reports that it was switched on."""

# commands
PING, NODE_READ, START_SYNC, BASE_READ = 0x0001, 0x0007, 0x003B, 0x0073
SET_TO_IDLE, SET_BEACON, BEACON_STATUS = 0x0091, 0xBEAC, 0xBEAD
BEACON_OFF = 0xFFFF_FFFF
"""Time in a command SET_BEACON that switches the beacon off."""

# places in the EEPROM, of base stations and nodes
CHANNEL_MASK, SERIAL_HIGH, SERIAL_LOW, MODEL, MODEL_OPTION, SAMPLE_RATE, FIRMWARE, FIRMWARE_2 = (
    12,
    20,
    22,
    46,
    48,
    72,
    108,
    110,
)

IDENTITY_PLACES = (MODEL, MODEL_OPTION, SERIAL_HIGH, SERIAL_LOW)
"""Places of the words that make up a serial number, in the order of `serial_number`."""

ERRORS = {
    1: "no such place in the EEPROM",
    2: "value out of bounds",
    3: "read only",
    4: "hardware fault",
}
"""Texts for the codes of a refusal."""

_UNKNOWN_RSSI = 0x7F
_MAX_MODE = 2
_CHANNELS_RADIO = range(11, 27)  # numbers of the radio channels
MAX_TIME_NS = 2**62
"""Range of the beacon's time: longer than that of any packet."""


def serial_number(model: int, option: int, high: int, low: int) -> str:
    """Return the serial number of a base station or a node, as printed on it, from words of its EEPROM."""
    return f"{model:04d}-{option:04d}-{high << 16 | low:05d}"


def firmware_version(word: int) -> str:
    """Return the version of a firmware from a word of the EEPROM."""
    return f"{word >> 8}.{word & 0xFF}"


@dataclass(frozen=True)
class ValueType:
    """Type of the values in a packet.

    Attributes:
        size: bytes of a value.
        signed: whether it is a signed integer.
        scale: factor from the integer to the value; None for a floating-point number.
        unused_bits: lowest bits that do not belong to the value.
    """

    size: int
    signed: bool = False
    scale: float | None = 1.0
    unused_bits: int = 0


VALUE_TYPES: dict[int, ValueType] = {
    1: ValueType(2, unused_bits=1),
    2: ValueType(4, scale=None),
    3: ValueType(2),
    4: ValueType(4),
    7: ValueType(2),
    8: ValueType(4, scale=None),
    9: ValueType(3),
    10: ValueType(2, scale=4.0),
    11: ValueType(3, signed=True),
    12: ValueType(2, signed=True, scale=64.0),
    13: ValueType(3),
    14: ValueType(2, scale=256.0),
    15: ValueType(2, signed=True, scale=0.1),
}
"""Type of the values by its code. 2: calibrated by the node, 8: not; 10, 12, 14: low bits of the converter cut off."""


@dataclass(frozen=True)
class Packet:
    """An intact packet from the base station.

    Attributes:
        kind: its type.
        address: address of the node, or BASE_ADDRESS.
        payload: its content.
        node_rssi_dBm, base_rssi_dBm: signal strength at the node and at the base station, dBm; None if unknown. Version
            1 has no check of these two.
    """

    kind: int
    address: int
    payload: bytes
    node_rssi_dBm: int | None
    base_rssi_dBm: int | None


class Sweeps(NamedTuple):
    """Consecutive sweeps, each with a value of each active channel.

    Attributes:
        rate_code: key of `rates.RATES_HZ`.
        tick: number of the first sweep, modulo 65536.
        time_ns: time of the first sweep on the beacon's clock, ns since 1970.
        channels: numbers of the channels from 1, ascending.
        values: shape (sweeps, channels).
    """

    rate_code: int
    tick: int
    time_ns: int
    channels: tuple[int, ...]
    values: NDArray[np.float64]


# --- frames ------------------------------------------------------------------------------------------------------


def packet_of(frame: bytes, version: Version) -> Packet | None:
    """Return the packet of a frame of the length that its head states; None if its check is wrong."""
    _, head, tail, _ = LAYOUTS[version]
    if version == 1:
        expected, found = sum(frame[1:-4]) & 0xFFFF, int.from_bytes(frame[-2:], "big")
    else:
        expected, found = zlib.crc32(frame[:-4]), int.from_bytes(frame[-4:], "big")
    if expected != found:
        return None
    node, base = (_rssi(byte) for byte in frame[-tail : 2 - tail])
    return Packet(frame[2], int.from_bytes(frame[3 : 5 if version == 1 else 7], "big"), frame[head:-tail], node, base)


def _rssi(byte: int) -> int | None:
    return None if byte == _UNKNOWN_RSSI else byte - 256 if byte >= 128 else byte


def request(version: Version, address: int, command: int, data: bytes = b"") -> bytes:
    """Encode a command to the base station (BASE_ADDRESS) or to a node.

    Args:
        version: version of the packets.
        address: address of the receiver.
        command: number of the command.
        data: its arguments.
    """
    payload = command.to_bytes(2, "big") + data
    to_base = address == BASE_ADDRESS
    kind = BASE_COMMAND if to_base else NODE_COMMAND
    if version == 1:
        body = bytes((0x0E if to_base else 0x05, kind)) + address.to_bytes(2, "big") + bytes((len(payload),)) + payload
        return bytes((LAYOUTS[1].start,)) + body + (sum(body) & 0xFFFF).to_bytes(2, "big")
    body = bytes((LAYOUTS[3].start, 0x01 if to_base else 0x04, kind)) + address.to_bytes(4, "big")
    body += len(payload).to_bytes(2, "big") + payload + bytes((_UNKNOWN_RSSI, _UNKNOWN_RSSI))
    return body + zlib.crc32(body).to_bytes(4, "big")


def node_bytes(version: Version, address: int) -> bytes:
    """Return the address of a node as an argument of a command to the base station."""
    return address.to_bytes(2 if version == 1 else 4, "big")


# --- sweeps ------------------------------------------------------------------------------------------------------


def is_discovery(packet: Packet) -> bool:
    """Return whether a node reports that it was switched on; the oldest nodes do it in a packet NODE_COMMAND."""
    data = packet.payload
    return packet.kind in DISCOVERIES or (packet.kind == NODE_COMMAND and len(data) == 3 and data[0] in _CHANNELS_RADIO)


def sweeps_of(packet: Packet, version: Version) -> bytes | None:
    """Return the content of a packet with sweeps in the layout of SYNC_SAMPLES; None for any other packet.

    Version 3 has no packets SYNC_SAMPLES_8.

    Raises:
        ValueError: mode or data type of a packet SYNC_SAMPLES_8 are impossible.
    """
    data = packet.payload
    if packet.kind == SYNC_SAMPLES:
        return data
    is_named = packet.kind == SYNC_SAMPLES_8 or (packet.kind == _MISNAMED_8 and data[:1] == bytes((_MAX_MODE,)))
    if version != 1 or not is_named:
        return None
    if len(data) < 4 or data[0] > _MAX_MODE or data[3] > 0x0F:
        raise ValueError(f"expected a sampling mode up to {_MAX_MODE} and a known data type, got {data[:4].hex()}")
    mode, mask, rate, kind = data[:4]
    return bytes((0, mask, rate, mode << 4 | kind)) + data[4:]


def parse_sweeps(payload: bytes, version: Version) -> Sweeps:
    """Parse the content of a packet SYNC_SAMPLES; see `sweeps_of`.

    Raises:
        ValueError: length, mode, data type, channels or time are impossible.
    """
    head = LAYOUTS[version].sweep_head
    if len(payload) <= head:
        raise ValueError(f"expected more than {number_of(head, 'byte')} of samples, got {len(payload)}")
    at = 0 if version == 1 else 4  # version 3 begins with four bytes that are not used here
    mask, rate, kind = int.from_bytes(payload[at : at + 2], "big"), payload[at + 2], payload[at + 3]
    if version == 1:
        if kind >> 4 > _MAX_MODE:
            raise ValueError(f"expected a sampling mode up to {_MAX_MODE}, got {kind >> 4}")
        kind &= 0x0F
    if kind not in VALUE_TYPES or not mask:
        raise ValueError(f"expected a known data type and channels, got type {kind}, mask {mask:#06x}")
    time_ns = _time_ns(payload[at + 6 : head], version)
    channels = tuple(n + 1 for n in range(16) if mask >> n & 1)
    size = VALUE_TYPES[kind].size * len(channels)
    if (len(payload) - head) % size:
        raise ValueError(f"expected sweeps of {number_of(size, 'byte')}, got {number_of(len(payload) - head, 'byte')}")
    values = _values(payload[head:], VALUE_TYPES[kind]).reshape(-1, len(channels))
    return Sweeps(rate, int.from_bytes(payload[at + 4 : at + 6], "big"), time_ns, channels, values)


def _time_ns(data: bytes, version: Version) -> int:
    if version == 1:
        seconds, nanoseconds = int.from_bytes(data[:4], "big"), int.from_bytes(data[4:], "big")
        if nanoseconds >= 10**9:
            raise ValueError(f"expected less than 10⁹ ns of a second, got {nanoseconds}")
        return seconds * 10**9 + nanoseconds
    time_ns = int.from_bytes(data, "big")
    if time_ns >= MAX_TIME_NS:
        raise ValueError(f"expected a time before the year 2116, got {time_ns} ns")
    return time_ns


def _values(data: bytes, kind: ValueType) -> NDArray[np.float64]:
    if kind.scale is None:
        with np.errstate(invalid="ignore"):  # a signalling NaN
            return np.frombuffer(data, ">f4").astype(np.float64)
    octets = np.frombuffer(data, np.uint8).reshape(-1, kind.size).astype(np.int64)
    whole = octets @ (256 ** np.arange(kind.size - 1, -1, -1))
    if kind.signed:
        whole -= (whole >> (8 * kind.size - 1)) << (8 * kind.size)
    return (whole >> kind.unused_bits).astype(np.float64) * np.float64(kind.scale)
