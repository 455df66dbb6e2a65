"""RIFTEK's binary protocol: requests to a sensor, packets from it.

A request consists of two bytes and an optional message; only its first byte has the top bit clear. Every byte from the
sensor has the top bit set and contains four bits of data, low half of a byte first, low byte of a word first:

- request ``0aaaaaaa 1000cccc [1000dddd …]``: a address (1 … 127, 0: every sensor), c code of the request, d data
- packet ``1Snndddd 1Snndddd …``: S = 1 the result is a new one, n number of the packet modulo 4

Codes of requests: 1 identification (answer: type u8, firmware u8, serial u16, base mm u16, range mm u16), 2 read of a
parameter (number u8; answer: value u8), 3 write (number u8, value u8; no answer), 4 store settings (AAh) or factory
settings (69h) (never sent; answer: the same u8), 6 one result (u16), 7 start and 8 stop of the stream (no answer). A
result D is 0 … 16384, at the distance D · range / 16384 from the begin of the range.

All bytes of a packet have the same high half, and the next packet has another number. Packets are separated by this
alone. A result of the stream has four bytes, the value of a parameter two, an identification sixteen. Answers have
S = 0 and share line and numbering with the stream. The line has no checksum, no longer counter and no time.

Sources: RF602 and AR100 manuals, serial interface pages; the layout of the longer stream forms is not public, so they
are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from daq.errors import DeviceError

IDENTIFY, READ, WRITE, STORE, LATCH, RESULT, START, STOP = range(1, 9)
"""Codes of requests."""
EVERYONE = 0
"""Address of all sensors on a line."""

POWER, CONTROL, AVERAGES, PERIOD, INTEGRATION, ZERO = 0x00, 0x02, 0x06, 0x08, 0x0A, 0x17
"""Parameters; PERIOD, INTEGRATION (both µs) and ZERO are words, whose high byte is the next parameter."""
CONTROL_KEPT = 0x92
"""Bits of CONTROL that do not influence the measurement: analogue output, CAN, and an unused bit."""

PERIODS_US, INTEGRATIONS_US, ZEROS = (100, 65_535), (3, 3200), (0, 16_383)
"""Smallest and largest values of these words."""

FULL_SCALE = 0x4000
"""The result at the end of the measuring range."""
RESULT_BYTES = 4
NUMBERS = 4
"""Packets are numbered modulo this."""
ANSWER_BYTES = {IDENTIFY: 16, READ: 2, STORE: 2, RESULT: RESULT_BYTES}
"""Length of the answers to requests on the line, bytes; other requests are not answered."""

UPDATED = 0x40
"""Bit of a packet's bytes: the result is a new one."""


def _halves(data: bytes) -> list[int]:
    return [half for byte in data for half in (byte & 0x0F, byte >> 4)]


def request(address: int, code: int, message: bytes = b"") -> bytes:
    """Encode a request to a sensor.

    Args:
        address: 1 … 127, or `EVERYONE`.
        code: `IDENTIFY` … `STOP`.
        message: number of the parameter, and its value for `WRITE`.

    Raises:
        ValueError: address or code is out of range.
    """
    if not (0 <= address <= 0x7F and 0 <= code <= 0x0F):
        raise ValueError(f"expected an address 0 … 127 and a code 0 … 15, got {address} and {code}")
    return bytes([address, 0x80 | code, *(0x80 | half for half in _halves(message))])


def packet(data: bytes, number: int, *, updated: bool = False) -> bytes:
    """Encode a packet from a sensor: an answer or one result.

    Args:
        data: data of the answer, or the two bytes of a result.
        number: number of the packet, taken modulo 4.
        updated: whether it is a new result.
    """
    head = 0x80 | (UPDATED if updated else 0) | (number & 3) << 4
    return bytes(head | half for half in _halves(data))


def results(codes: ArrayLike, numbers: ArrayLike, *, updated: bool = True) -> bytes:
    """Encode results as a sensor streams them.

    Args:
        codes: results, 0 … 65535, shape (n,).
        numbers: numbers of their packets, taken modulo 4, shape (n,).
        updated: whether they are new results.
    """
    code = np.asarray(codes, np.int64)[:, None] >> np.array([0, 4, 8, 12]) & 0x0F
    head = 0x80 | (UPDATED if updated else 0) | (np.asarray(numbers, np.int64)[:, None] & 3) << 4
    return (code | head).astype(np.uint8).tobytes()


def awaited(sent: bytes) -> int | None:
    """Return the length of the answer to the last request in sent bytes; None if it is not answered."""
    begin = max((at for at, byte in enumerate(sent) if byte < 0x80), default=None)
    if begin is None or begin + 1 >= len(sent):
        return None
    return ANSWER_BYTES.get(sent[begin + 1] & 0x0F)


def codes_of(sent: bytes) -> set[int]:
    """Return the codes of the requests in sent bytes."""
    return {code & 0x0F for address, code in pairwise(sent) if address < 0x80}


class SensorIdentity(NamedTuple):
    """Identification of a sensor.

    Attributes:
        kind, firmware, serial: numbers.
        base_m: distance from the sensor to the beginning of its range, m.
        range_m: measuring range, m.
    """

    kind: int
    firmware: int
    serial: int
    base_m: float
    range_m: float


def parse_info(data: bytes) -> SensorIdentity:
    """Parse the eight bytes of an identification.

    Raises:
        DeviceError: the length is wrong, or the range is 0.
    """
    if len(data) != ANSWER_BYTES[IDENTIFY] // 2:
        raise DeviceError(f"expected 8 bytes of identification, got {len(data)} ({data.hex()}): is this an RF60x?")
    serial, base_mm, range_mm = (int.from_bytes(data[at : at + 2], "little") for at in (2, 4, 6))
    if not range_mm:
        raise DeviceError(f"expected a measuring range above 0 mm in the identification, got {data.hex()}")
    return SensorIdentity(data[0], data[1], serial, base_mm / 1000.0, range_mm / 1000.0)


def metres(code: ArrayLike, range_m: float) -> NDArray[np.float64]:
    """Convert results D to distances from the beginning of the measuring range S, m: D·S/16384.

    Args:
        code: results, any shape.
        range_m: measuring range, m.
    """
    return np.asarray(code, np.float64) * (range_m / FULL_SCALE)


def readings(code: ArrayLike, range_m: float, no_target_codes: Sequence[int]) -> NDArray[np.float64]:
    """Convert results as `metres` does; NaN for those above full scale, and for the codes without a target."""
    codes = np.asarray(code)
    is_reading = (codes <= FULL_SCALE) & ~np.isin(codes, no_target_codes)
    return np.where(is_reading, metres(codes, range_m), np.nan)


def code(metres: ArrayLike, range_m: float) -> NDArray[np.int64]:
    """Convert distances to results of a sensor; inverse of `metres` to half a step (range · 3.1e-5).

    Args:
        metres: distance from the beginning of the range, m, any shape, within 0 … range_m.
        range_m: measuring range, m.
    """
    return np.rint(np.asarray(metres, np.float64) * (FULL_SCALE / range_m)).astype(np.int64)
