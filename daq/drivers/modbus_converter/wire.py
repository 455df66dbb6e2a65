"""Requests to a converter and its answers: Modbus RTU frames, a pure codec without line and clock.

pymodbus builds and parses the frames. An answer to a read contains no register number: it can only be interpreted with
its request. Facts and their sources: docs/protocols/modbus_converter.md.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from pymodbus.exceptions import ModbusException
from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # damage is counted by the pipeline

READS, WRITE_ONE, WRITE_SOME = (3, 4), 6, 16
LONGEST_FRAME_BYTES = 256
_REFUSED = 0x80
_REFUSAL_BYTES, _CRC_BYTES = 5, 2

_SENT = FramerRTU(DecodePDU(is_server=True))
_REQUESTS: dict[int, type[ModbusPDU]] = {
    3: ReadHoldingRegistersRequest,
    4: ReadInputRegistersRequest,
    6: WriteSingleRegisterRequest,
    16: WriteMultipleRegistersRequest,
}
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


def encode(request: Request) -> bytes:
    """Encode a request.

    Raises:
        ValueError: an address or a number of registers is out of range.
    """
    pdu = _REQUESTS[request.function](
        dev_id=request.address,
        address=request.register,
        count=request.count,
        registers=list(request.values) if request.values else None,
    )
    return _SENT.buildFrame(pdu)


def parse_request(frame: bytes) -> Request | None:
    """Parse a frame of the host; None if it is not a request of the kinds in `Request`."""
    if len(frame) < _REFUSAL_BYTES or frame[1] not in _REQUESTS:
        return None
    try:
        _, pdu = _SENT.handleFrame(frame, 0, 0)
    except ModbusException:  # usual: another program's bytes
        return None
    if pdu is None:
        return None
    values = () if pdu.function_code in READS else tuple(pdu.registers)
    count = len(values) or pdu.count
    request = Request(pdu.dev_id, pdu.function_code, pdu.address, count, values)
    return request if encode(request) == frame else None


def _expected(request: Request) -> tuple[bytes, int]:
    """Return the beginning of the answer that a request expects, and the length of the answer in bytes."""
    head = bytes([request.address, request.function])
    if request.function in READS:
        size = 2 * request.count
        return head + bytes([size]), len(head) + 1 + size + _CRC_BYTES
    body = request.values[0] if request.function == WRITE_ONE else request.count
    whole = head + request.register.to_bytes(2, "big") + body.to_bytes(2, "big")
    return whole, len(whole) + _CRC_BYTES


def _intact(frame: bytes) -> bool:
    return FramerRTU.check_CRC(frame[:-_CRC_BYTES], int.from_bytes(frame[-_CRC_BYTES:], "big"))


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
            values = tuple(int.from_bytes(body[k : k + 2], "big") for k in range(0, len(body), 2))
            return at, at + size, Answer(request, values)
        end = at + _REFUSAL_BYTES
        if data.startswith(refused, at) and data[at + 2] and _intact(data[at:end]):
            return at, end, Answer(request, exception=data[at + 2])
    return None
