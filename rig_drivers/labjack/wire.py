"""Messages of a LabJack T4 or T7 on TCP port 502: Modbus TCP with the maker's function 76 ("Modbus feedback").

All numbers are big-endian. A message consists of transaction number u16 (an answer has that of its request), 0 u16,
number of the bytes that follow u16, unit 1 u8, and function 4Ch u8. A request then contains parts
``01 address count data`` (write) and ``00 address count`` (read), an answer the registers read. Function CCh is a
refusal, with the exception in the next byte. Register 55000 then has the error: 2605 a stream runs, 2620 no stream
runs, 2607 input cannot be streamed, 2608 scan rate too high.

An answer to a stream read (register 4500) has number of samples, bytes that still wait, status, additional
information, and samples of 16 bits in the order of the scan list. What is not verified: docs/protocols/labjack.md.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FEEDBACK, REFUSED = 0x4C, 0xCC
"""Function of a request and its answer, and function of the answer that refuses."""
MOST_REGISTERS = 240
"""Registers of one read: an answer with them fits a WiFi packet of 500 bytes."""
STATE_REGISTERS = 4
"""Registers before the samples of a stream read: number of samples, backlog in bytes, status, information."""
FIRST_STREAM_ID = 0x8000
"""Transaction numbers of stream reads; smaller ones belong to the opening dialogue."""
ERROR_NUMBER = 0x7FFF
"""Transaction number of the read of LAST_ERROR after a refused stream read."""
NO_VALUE = 0xFFFF
"""Sample of an input above its range. The scan that stands for skipped ones has it at all inputs."""
_HEADER = struct.Struct(">HHHBB")
_PART = struct.Struct(">BHB")
_WRITE, _READ = 1, 0
_UNIT = 1
_ANSWER_FUNCTIONS = (FEEDBACK, REFUSED)
_LONGEST_BYTES = 2 + 2 * 255


class Register(IntEnum):
    """Addresses of registers."""

    DIGITAL_LINE = 2000
    LINE_STATES = 2500
    STREAM_SCAN_RATE_HZ = 4002
    STREAM_ADDRESSES = 4004
    STREAM_SAMPLES_PER_PACKET = 4006
    STREAM_SETTLING_US = 4008
    STREAM_RESOLUTION = 4010
    STREAM_BUFFER_BYTES = 4012
    STREAM_CLOCK_SOURCE = 4014
    STREAM_TARGET = 4016
    STREAM_DATA_TYPE = 4018
    STREAM_SCANS = 4020
    STREAM_TRIGGER = 4024
    STREAM_SCAN_LIST = 4100
    STREAM_DATA = 4500
    STREAM_ENABLE = 4990
    AIN_RANGE = 40000
    AIN_NEGATIVE = 41000
    AIN_POWER = 48005
    LAST_ERROR = 55000
    PRODUCT = 60000
    FIRMWARE = 60004
    SERIAL = 60028
    FLASH_POINTER = 61810
    FLASH = 61812


TARGET_COMMAND = 16
"""Value of STREAM_TARGET: the stream is read by commands, on the port and the connection of all commands."""
BUFFER_BYTES = 32_768
"""Size of the device's buffer that is set up; it must be a power of 2."""
FLASH_CONSTANTS = 0x3C4000
"""Address of the calibration constants in the internal flash."""


class Status(IntEnum):
    """Status of a stream read, and errors that refuse a request (value of LAST_ERROR)."""

    GOOD = 0
    STREAM_IS_ACTIVE = 2605
    STREAM_NOT_RUNNING = 2620
    RECOVERING = 2940
    RECOVERED = 2941
    SCAN_OVERLAP = 2942
    RECOVERED_TOO_MANY = 2943


_ERRORS = {
    Status.STREAM_IS_ACTIVE: "a stream runs, which another program owns. End that program, or restart the device",
    2607: "an input cannot be streamed. Correct the inputs in the rig file",
    2608: "the scan rate is too high. Lower scan_rate_Hz, or connect fewer inputs",
    Status.STREAM_NOT_RUNNING: "no stream runs: another program ended it, or the device has lost its power",
}


def explain(error: int) -> str:
    """Return the meaning of an error of the device with its number; 0 if the device states none."""
    if not error:
        return "it states no error"
    meaning = _ERRORS.get(error, "look it up in the maker's list of errors")
    return f"error {error}, {meaning}"


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        number: transaction number; an answer has that of its request.
        function: FEEDBACK, or REFUSED for an answer that refuses.
        body: the bytes after the function.
    """

    number: int
    function: int
    body: bytes


class DecodedMessages(NamedTuple):
    """Messages of one read, and the number of bytes between them that belong to none."""

    messages: list[Message]
    skipped_bytes: int


def encode(message: Message) -> bytes:
    """Encode a message."""
    head = _HEADER.pack(message.number, 0, 2 + len(message.body), _UNIT, message.function)
    return head + message.body


def write(register: int, data: bytes) -> bytes:
    """Return the part of a feedback request that writes registers, two bytes each."""
    return _PART.pack(_WRITE, register, len(data) // 2) + data


def read(register: int, count: int) -> bytes:
    """Return the part of a feedback request that reads registers."""
    return _PART.pack(_READ, register, count)


def request(number: int, parts: Sequence[bytes]) -> bytes:
    """Return a feedback request of several parts, which the device carries out in their order."""
    return encode(Message(number, FEEDBACK, b"".join(parts)))


def stream_number(count: int) -> int:
    """Return the transaction number of a stream read from its count, 0, 1, …"""
    return FIRST_STREAM_ID | count % FIRST_STREAM_ID


def samples_per_read(inputs: int) -> int:
    """Return the number of samples of a stream read: as many whole scans as fit."""
    return (MOST_REGISTERS - STATE_REGISTERS) // inputs * inputs


def stream_request(count: int, inputs: int) -> bytes:
    """Return a stream read from its count and the number of inputs in the scan list."""
    registers = STATE_REGISTERS + samples_per_read(inputs)
    return request(stream_number(count), [read(Register.STREAM_DATA, registers)])


def parts_of(body: bytes) -> Iterator[tuple[int, int, bytes | None]]:
    """Yield register, number of registers, and the bytes to write of each part of a request; None for a read."""
    at = 0
    while at + _PART.size <= len(body):
        kind, register, count = _PART.unpack_from(body, at)
        at += _PART.size
        yield register, count, None if kind == _READ else body[at : at + 2 * count]
        at += 0 if kind == _READ else 2 * count


def start_number(data: bytes) -> int | None:
    """Return the transaction number of a request that starts the stream; None for all other bytes of the host."""
    for message in MessageDecoder().feed(data).messages:
        written = [
            any(value or b"") for register, _, value in parts_of(message.body) if register == Register.STREAM_ENABLE
        ]
        if message.number < FIRST_STREAM_ID and any(written):
            return message.number
    return None


@dataclass(frozen=True)
class StreamRead:
    """Content of the answer to a stream read.

    Attributes:
        samples: in the order of the scan list, shape (n,).
        backlog_bytes: bytes that wait in the device's buffer.
        status: a Status, or an unknown number.
        info: additional information: the number of skipped scans, if the status is RECOVERED.
    """

    samples: NDArray[np.uint16]
    backlog_bytes: int
    status: int
    info: int

    @property
    def waiting(self) -> int:
        """Number of samples that wait in the device's buffer."""
        return self.backlog_bytes // 2


def parse_stream(body: bytes) -> StreamRead | None:
    """Read the body of the answer to a stream read; None if it is not one. Bytes after the samples are padding."""
    if len(body) < 2 * STATE_REGISTERS:
        return None
    count, backlog, status, info = struct.unpack_from(">4H", body)
    if len(body) < 2 * (STATE_REGISTERS + count):
        return None
    samples = np.frombuffer(body, ">u2", count, 2 * STATE_REGISTERS).astype(np.uint16)
    return StreamRead(samples, backlog, status, info)


class MessageDecoder:
    """Decodes the device's bytes to messages. The result does not depend on the split into reads; memory is bounded."""

    def __init__(self) -> None:
        self._rest = b""
        self._before = 6 + _LONGEST_BYTES  # bytes that may precede the first message: a log may begin within one

    def feed(self, data: bytes) -> DecodedMessages:
        """Decode the next bytes."""
        stream, at = self._rest + data, 0
        messages: list[Message] = []
        skipped = 0
        while len(stream) - at >= _HEADER.size:
            number, protocol, length, unit, function = _HEADER.unpack_from(stream, at)
            known = protocol == 0 and unit == _UNIT and function in _ANSWER_FUNCTIONS
            if not known or not 2 <= length <= _LONGEST_BYTES:
                skipped += self._before <= 0
                self._before -= 1
                at += 1
                continue
            end = at + 6 + length
            if end > len(stream):
                break
            messages.append(Message(number, function, stream[at + _HEADER.size : end]))
            self._before, at = 0, end
        self._rest = stream[at:]
        return DecodedMessages(messages, skipped)
