"""Objects of a node, read and written by expedited SDO transfers (CiA 301) over the recorded link."""

from __future__ import annotations

import contextlib
import queue
import struct
from collections.abc import Callable

from typing_extensions import override

from daq.drivers.canopen import cia301
from daq.drivers.contract import Talk
from daq.drivers.questions import TRIES
from daq.errors import DeviceError
from daq.transports.can_frames import CanFrame, encode
from daq.transports.host_clock import HostClock

_ANSWER_S = 0.3  # s to wait for an answer
_SDO = struct.Struct("<BHBI")
_READ, _WRITE, _ABORT = 0x40, 0x23, 0x80
_KIND = 0xE0  # bits of a command byte that state the kind of a request or answer
_ANSWERS = {0x20: 0x60, 0x40: 0x40}  # kinds of the answers to a write and to a read
_EXPEDITED = 0x42  # command byte, under the mask 0xE2, of an answer that contains the value itself
_TIMED_OUT = 0x05040000
_REASONS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "time-out",
    0x05040001: "unknown command",
    0x05040005: "out of memory",
    0x06010000: "access not supported",
    0x06010001: "can only be written",
    0x06010002: "can only be read",
    0x06020000: "no such object",
    0x06040041: "cannot be mapped to a PDO",
    0x06040042: "too long for the PDO",
    0x06040043: "parameters do not fit",
    0x06040047: "internal contradiction in the node",
    0x06060000: "hardware error",
    0x06070010: "wrong length",
    0x06070012: "too long",
    0x06070013: "too short",
    0x06090011: "no such sub-index",
    0x06090030: "value out of range",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x06090036: "maximum below minimum",
    0x060A0023: "resource not available",
    0x08000000: "general error",
    0x08000020: "cannot be transferred or stored",
    0x08000021: "cannot be transferred or stored: local control",
    0x08000022: "cannot be transferred or stored in the present state",
    0x08000023: "no object dictionary",
    0x08000024: "no data",
}
"""Abort codes of CiA 301."""


class NoAnswer(DeviceError):
    """A node did not answer; other errors of `NodeObjects` are refusals."""


class NodeObjects:
    """A node's objects, and its bus.

    Args:
        name: name of the node in messages.
        node_id: node number.
        send: writes records of `can_frames` to the node's link (and to the log).
        clock: clock for timeouts.
    """

    def __init__(self, name: str, node_id: int, send: Callable[[bytes], None], clock: HostClock) -> None:
        self.node_id: int = node_id
        self._name, self._send, self._clock = name, send, clock
        self._answers: queue.Queue[bytes] = clock.queue()
        self._asked = b""  # the request, until it is answered

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        self._send(encode(CanFrame(identifier, data)))

    def request(self, identifier: int, size: int) -> None:
        """Request the process data of an identifier, of `size` bytes, by a remote frame."""
        self._send(encode(CanFrame(identifier, bytes(size), remote=True)))

    def take_answer(self, data: bytes) -> None:
        """Take an answer of the node, 8 bytes, unless it is late to another request, or no answer is expected."""
        asked = self._asked
        if not asked or data[1:4] != asked[1:4]:
            return
        if data[0] == _ABORT or data[0] & _KIND == _ANSWERS[asked[0] & _KIND]:
            self._answers.put(data)

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Write an object of `size` bytes and wait until the node confirms it.

        Raises:
            NoAnswer: the node does not answer.
            DeviceError: the node refuses the value.
        """
        request = _SDO.pack(_WRITE | (4 - size) << 2, index, sub, value)
        answer = self._ask(f"writing {index:04X}h sub {sub}", request)
        if answer[0] == _ABORT:
            code = int.from_bytes(answer[4:], "little")
            raise DeviceError(
                f"{self._name}: refused {value} at {index:04X}h sub {sub}: code 0x{code:08X}, "
                f"{_REASONS.get(code, 'unknown to CiA 301')}"
            )

    def read(self, index: int, sub: int) -> int | None:
        """Return the unsigned value of an object of up to 4 bytes; None if the node has no such object or refuses it.

        Raises:
            NoAnswer: the node does not answer.
        """
        return value_of(self._ask(f"reading {index:04X}h sub {sub}", _SDO.pack(_READ, index, sub, 0)))

    def _ask(self, what: str, request: bytes) -> bytes:
        """Return the answer to a request, which is repeated up to `TRIES` times."""
        for _ in range(TRIES):
            with contextlib.suppress(queue.Empty):  # usual: no late answer is left
                while True:
                    self._answers.get_nowait()
            self._asked = request
            try:
                self.send(cia301.cob_sdo_request(self.node_id), request)
                return self._answer(_ANSWER_S)
            except queue.Empty:  # usual: the request is repeated
                self.send(cia301.cob_sdo_request(self.node_id), abort(request, _TIMED_OUT))
            finally:
                self._asked = b""
        raise NoAnswer(
            f"{self._name}: no answer to {what} after {TRIES} tries. Is node {self.node_id} powered, the bit rate "
            "right, the bus terminated?"
        )

    def _answer(self, seconds: float) -> bytes:
        """Wait for the answer. Raises queue.Empty without one."""
        return self._answers.get(timeout=seconds)


class DialogueObjects(NodeObjects):
    """A node's objects during the opening of a device, whose pipeline reports SDO answers as `reply` events.

    Args:
        name: name of the node in messages.
        node_id: node number.
        talk: the open device.
    """

    def __init__(self, name: str, node_id: int, talk: Talk) -> None:
        super().__init__(name, node_id, talk.send, talk.clock)
        self._talk = talk

    @override
    def _answer(self, seconds: float) -> bytes:
        deadline = self._clock.now_s() + seconds
        while self._answers.empty():
            text = self._talk.replies.get(timeout=max(0.0, deadline - self._clock.now_s()))
            identifier, _, data = text.partition(" ")
            if identifier == f"{cia301.cob_sdo_answer(self.node_id):03X}" and len(data) == 2 * _SDO.size:
                self.take_answer(bytes.fromhex(data))
        return self._answers.get_nowait()


def answer_text(frame: CanFrame) -> str:
    """Return the text of a `reply` event with an answer of a node."""
    return f"{frame.arbitration_id:03X} {frame.data.hex()}"


def abort(request: bytes, code: int) -> bytes:
    """Return the 8 bytes that abort the transfer of a request."""
    return bytes([_ABORT]) + request[1:4] + code.to_bytes(4, "little")


def read_request(index: int, sub: int) -> bytes:
    """Return the 8 bytes of a request to read an object."""
    return _SDO.pack(_READ, index, sub, 0)


def value_of(answer: bytes) -> int | None:
    """Return the value in the answer to a read, 8 bytes; None if it is refused, or has more than 4 bytes."""
    if answer[0] & 0xE2 != _EXPEDITED:
        return None
    size = 4 - (answer[0] >> 2 & 3) if answer[0] & 1 else 4
    return int.from_bytes(answer[4 : 4 + size], "little")
