"""Requests to a converter and its answers: Modbus RTU frames, a pure codec without line and clock.

An answer to a read contains no register number: it can only be interpreted with its request. Facts and their sources:
docs/protocols/modbus_converter.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import reduce

READS, WRITE_ONE, WRITE_SOME = (3, 4), 6, 16
LONGEST_FRAME_BYTES = 256
_MOST_READ = 125  # registers: their answer has the longest frame
_REFUSED = 0x80
_SHORTEST_REQUEST_BYTES, _REFUSAL_BYTES, _CRC_BYTES = 8, 5, 2

REFUSALS = {
    1: "the function code is not supported, or not possible in its present state",
    2: "no such register, or not this many registers from it on",
    3: "the value is not allowed",
    4: "it failed to execute the request",
    5: "it is still executing the request",
    6: "it is busy",
    7: "it does not execute the request in its present state",
    8: "parity error in its memory",
    10: "the gateway has no path to it",
    11: "it does not answer the gateway",
}
"""Reasons by exception code. Source: Modbus application protocol; some makers define those from 4 on differently."""


@dataclass(frozen=True)
class Request:
    """A request of the host.

    Attributes:
        address: Modbus address of the converter.
        function: function code: 3 or 4 reads, 6 or 16 writes.
        register: first register, from 0.
        count: number of registers.
        values: values to write; empty for a read.
    """

    address: int
    function: int
    register: int
    count: int
    values: tuple[int, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Part of the request that its answer repeats: requests of one shape have interchangeable answers."""
        if self.function in READS:
            return self.address, self.function, self.count
        return self.address, self.function, self.register, *(self.values if self.function == WRITE_ONE else ())

    @property
    def words(self) -> str:
        """What is requested, for a message."""
        what = "reading" if self.function in READS else f"writing {', '.join(map(str, self.values))} to"
        return f"{what} register {self.register}"


@dataclass(frozen=True)
class Answer:
    """An answer to a request.

    Attributes:
        request: the request.
        registers: values that were read; empty for a write or a refusal.
        exception: exception code of a refusal, otherwise 0.
    """

    request: Request
    registers: tuple[int, ...] = ()
    exception: int = 0

    @property
    def refusal(self) -> str:
        """Reason of the refusal; empty if it is not one."""
        if not self.exception:
            return ""
        return f"exception {self.exception}: {REFUSALS.get(self.exception, 'not in the standard, see its manual')}"


def with_crc(body: bytes) -> bytes:
    """Return a frame: a body and its CRC-16 (polynomial A001h reflected, start FFFFh, low byte first)."""
    value = reduce(lambda crc, byte: crc >> 8 ^ _CRC_OF_BYTE[(crc ^ byte) & 0xFF], body, 0xFFFF)
    return body + value.to_bytes(_CRC_BYTES, "little")


_CRC_OF_BYTE = [reduce(lambda crc, _: crc >> 1 ^ (0xA001 if crc & 1 else 0), range(8), byte) for byte in range(256)]


def encode(request: Request) -> bytes:
    """Encode a request.

    Raises:
        struct.error: an address, a number of registers or a value is out of range.
    """
    head = struct.pack(">BBH", request.address, request.function, request.register)
    if request.function in READS:
        return with_crc(head + struct.pack(">H", request.count))
    values = struct.pack(f">{request.count}H", *request.values)
    if request.function == WRITE_ONE:
        return with_crc(head + values)
    return with_crc(head + struct.pack(">HB", request.count, len(values)) + values)


def parse_request(frame: bytes) -> Request | None:
    """Parse a frame of the host; None if it is not a request of the kinds in `Request`."""
    is_whole = _SHORTEST_REQUEST_BYTES <= len(frame) <= LONGEST_FRAME_BYTES
    if not is_whole or frame[1] not in (*READS, WRITE_ONE, WRITE_SOME):
        return None
    address, function, register, word = struct.unpack_from(">BBHH", frame)
    if function in READS:
        request = Request(address, function, register, min(word, _MOST_READ))
    else:
        data = frame[4:6] if function == WRITE_ONE else frame[7:-_CRC_BYTES]
        values = struct.unpack_from(f">{len(data) // 2}H", data)
        request = Request(address, function, register, len(values), values)
    return request if encode(request) == frame else None


def encode_answer(answer: Answer) -> bytes:
    """Encode a converter's answer."""
    if answer.exception:
        return with_crc(bytes([answer.request.address, answer.request.function | _REFUSED, answer.exception]))
    return with_crc(_expected(answer.request)[0] + struct.pack(f">{len(answer.registers)}H", *answer.registers))


def _expected(request: Request) -> tuple[bytes, int]:
    """Return the beginning of the answer that a request expects, and the length of the answer in bytes."""
    if request.function in READS:
        head, size = bytes([request.address, request.function, 2 * request.count]), 2 * request.count
    else:
        head, size = encode(request)[:6], 0
    return head, len(head) + size + _CRC_BYTES


def _intact(frame: bytes) -> bool:
    return with_crc(frame[:-_CRC_BYTES]) == frame


def find_answer(data: bytes, request: Request) -> tuple[int, int, Answer] | None:
    """Find the intact answer to a request in received bytes, also after other bytes.

    Returns:
        Where it begins, where it ends, and the answer; None if no intact answer to this request is in the bytes.
    """
    head, size = _expected(request)
    refused = bytes([request.address, request.function | _REFUSED])
    for at in range(len(data) - _REFUSAL_BYTES + 1):
        if data.startswith(head, at) and at + size <= len(data) and _intact(data[at : at + size]):
            body = data[at + len(head) : at + size - _CRC_BYTES]
            return at, at + size, Answer(request, struct.unpack(f">{len(body) // 2}H", body))
        end = at + _REFUSAL_BYTES
        if data.startswith(refused, at) and data[at + 2] and _intact(data[at:end]):
            return at, end, Answer(request, exception=data[at + 2])
    return None
